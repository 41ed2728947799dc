"""Log of a unit with hidden effects: own integrator at a tenth of the simulator's step, own friction, own noise."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system
from tests.oracle.excitations import Drive, make_drive
from tests.oracle.machines import MACHINES, Body, soft_sign

Hidden = Mapping[str, Mapping[str, Any]]
Load = Callable[[float, float, float, float, float], float]
STEP = 1e-3  # longest integration step [s]
NO_LAG = 1e-4  # time constant that does nothing the sensors show, and would only ask for short steps [s]
SHARPNESS = 0.01  # of dry friction [per s]
SLACK = 0.15  # way from the start on which a tether does not pull [rad or m]
SENSOR_RATE, COMMAND_RATE = 100.0, 50.0  # [Hz]
PLACED = re.compile(r"(\w+)(?:\((?:joint (\d+)|(\w+))\))?$")


class HiddenUnit:
    """A unit with parameters drawn within the priors of its system.

    Args:
        system: Name of the system.
        hidden: Effects by the names of the catalogue, with their parameters.
        seed: Seed of the parameters.
        drawn: Seed of noise and turbulence; None takes the other one.
        varies: Standard deviation by which parameters differ from recording to recording, as a share of each.
    """

    def __init__(
        self, system: str, hidden: Hidden, seed: int, drawn: int | None = None, varies: float = 0.0
    ) -> None:
        self.system = make_system(system)
        rng = np.random.default_rng([seed, 1])
        self.parameters: dict[str, float] = {}
        for p in self.system.parameters:
            # Within two standard deviations: beyond that the data sheet would be wrong.
            shift = float(np.clip(rng.standard_normal(), -2.0, 2.0))
            self.parameters[p.name] = float(np.clip(p.value + p.prior_sd * shift, p.low, p.high))
        today = np.random.default_rng([seed if drawn is None else drawn, 6])
        for p in self.system.parameters if varies else ():
            own = self.parameters[p.name] * (1.0 + varies * today.standard_normal())
            self.parameters[p.name] = float(np.clip(own, p.low, p.high))
        self.hidden: dict[tuple[str, int | str], dict[str, Any]] = {}
        for name, values in hidden.items():
            match = PLACED.match(name)
            assert match is not None
            kind, joint, channel = match.groups()
            self.hidden[kind, channel or int(joint or 1) - 1] = dict(values)
        joints = self.system.joints
        tilt = self._of("tilt")
        body = Body(
            self._of("payload").get("mass", 0.0),
            tuple(self._of("length", j).get("factor", 1.0) for j in range(joints)),
            tuple(tilt.values()) or (0.0, 0.0),
        )
        self.law = MACHINES[system](self.parameters, body)
        base_lag = self.parameters.get("motor_lag", 0.0)
        self.lags = [
            [x for x in (base_lag, self._of("lag", k).get("time_constant", 0.0)) if x > NO_LAG]
            for k in range(len(self.system.commands))
        ]
        drawn = seed if drawn is None else drawn
        self.rng = np.random.default_rng([drawn, 2])
        self.turbulence = np.random.default_rng([drawn, 3])
        self.losses = np.random.default_rng([drawn, 4])

    def _of(self, kind: str, site: int | str = 0) -> dict[str, Any]:
        return self.hidden.get((kind, site), {})

    def delivered(self, k: int, command: float, t: float, last: float) -> float:
        """Effort that answers a command, before any lag; ``last`` is what answered the one before."""
        width = self._of("backlash", k).get("width", 0.0)
        u = min(max(last, command - width), command + width) if width else command
        u *= 1.0 + self._of("gain_drift", k).get("rate", 0.0) * t
        u *= self._of("gain", k).get("factor", 1.0)
        u += self._of("gain_curve", k).get("curvature", 0.0) * u**3
        u += self._of("asymmetry", k).get("share", 0.0) * abs(u)
        u += self._of("torque_bias", k).get("effort", 0.0)
        zone = self._of("dead_zone", k).get("width", 0.0)
        u = math.copysign(max(abs(u) - zone, 0.0), u) if zone else u
        limit = self._of("saturation", k).get("limit", math.inf)
        return min(max(u, -limit), limit)

    def load_on(self, j: int, start: float = 0.0) -> Load | None:
        """Load of the hidden effects on one joint, from angle, speed, effort, time and gust; None where none acts.

        Args:
            j: The joint.
            start: Position at which a log starts, around which a tether is slack.
        """
        parts = [self._friction(j), self._waves(j), self._rest(j), self._tether(j, start)]
        acting = [part for part in parts if part is not None]
        if not acting:
            return None
        if len(acting) == 1:
            return acting[0]
        return lambda q, v, u, t, gust: sum(part(q, v, u, t, gust) for part in acting)

    def _friction(self, j: int) -> Load | None:
        kinds = (
            "viscous",
            "asymmetric_viscous",
            "quadratic",
            "coulomb",
            "stribeck",
            "load_friction",
            "torque_speed_curve",
        )
        own = [self._of(kind, j) for kind in kinds]
        if not any(own):
            return None
        viscous, asymmetric, quadratic, coulomb, stribeck, loaded, motor = own
        half = 0.5 * asymmetric.get("difference", 0.0)
        change, drag = viscous.get("change", 0.0), quadratic.get("drag", 0.0)
        constant = coulomb.get("torque", 0.0) + stribeck.get("coulomb", 0.0)
        excess, speed = stribeck.get("breakaway", 0.0), stribeck.get("speed", 1.0)
        share = loaded.get("coefficient", 0.0)
        droop = motor.get("droop", 0.0)

        def load(q: float, v: float, u: float, t: float, gust: float) -> float:
            one_way = change + half if v > 0.0 else change - half
            total = -one_way * v - drag * v * abs(v)
            if u * v > 0.0:
                total -= droop * abs(v) * u
            level = constant + share * abs(u)
            if excess:
                level += excess * math.exp(-((v / speed) ** 2))
            return total - level * soft_sign(v, SHARPNESS) if level else total

        return load

    def _waves(self, j: int) -> Load | None:
        cogging, periodic = self._of("cogging", j), self._of("periodic", j)
        if not (cogging or periodic):
            return None
        cycles, sine, cosine = (cogging.get(n, 0.0) for n in ("cycles", "sine", "cosine"))
        rate, high, low = (periodic.get(n, 0.0) for n in ("frequency", "sine", "cosine"))

        def load(q: float, v: float, u: float, t: float, gust: float) -> float:
            turn, phase = cycles * q, rate * t
            wave = sine * math.sin(turn) + cosine * math.cos(turn)
            return wave + high * math.sin(phase) + low * math.cos(phase)

        return load

    def _rest(self, j: int) -> Load | None:
        push, size = self._of("event", j), self._of("turbulence", j).get("size", 0.0)
        damping = self._of("position_friction", j).get("size", 0.0)
        if not (push or size or damping):
            return None
        torque = push.get("torque", 0.0)
        begin = push.get("start", math.inf)
        end = begin + push.get("duration", 0.0)

        def load(q: float, v: float, u: float, t: float, gust: float) -> float:
            pushed = torque if begin <= t < end else 0.0
            return pushed - damping * (1.0 + math.cos(q)) * v + size * gust

        return load

    def _tether(self, j: int, start: float) -> Load | None:
        stiffness = self._of("tether", j).get("stiffness", 0.0)
        if not stiffness:
            return None

        def load(q: float, v: float, u: float, t: float, gust: float) -> float:
            away = q - start
            return -stiffness * math.copysign(max(abs(away) - SLACK, 0.0), away)

        return load


def hidden_log(
    system: str,
    hidden: Hidden,
    excitation: str | Drive,
    seed: int,
    seconds: float = 30.0,
    noisy: bool = True,
    take: int = 0,
    varies: float = 0.0,
) -> Recording:
    """Record a unit in simulated time.

    Args:
        system: Name of the system.
        hidden: Effects by the names of the catalogue, and besides ``turbulence``, ``position_friction`` and
            ``tether``, which it does not know.
        excitation: ``steps``, ``chirp``, ``closed-loop`` or ``bang-bang``; or commands of one's own.
        seed: Seed of parameters, excitation and noise.
        seconds: Length of the log [s].
        noisy: Whether sensors have noise, quantisation and jitter.
        take: Which recording of the unit; each has an excitation and noise of its own, the parameters are the same.
        varies: Standard deviation by which they differ from take to take nevertheless, as a share of each.
    """
    # What the first take drew stays what it was before there were others.
    drawn = int(np.random.SeedSequence([seed, 5, take]).generate_state(1)[0]) if take else seed
    unit = HiddenUnit(system, hidden, seed, drawn, varies)
    log = _Run(unit, excitation, drawn, seconds, noisy)
    log.run()
    return log.recording()


class _Run:
    """One recording under way: time goes from event to event (samples, commands that begin to act)."""

    def __init__(
        self, unit: HiddenUnit, excitation: str | Drive, seed: int, seconds: float, noisy: bool
    ) -> None:
        self.unit, self.seconds, self.noisy = unit, seconds, noisy
        system = unit.system
        named = isinstance(excitation, str)
        self.drive = make_drive(excitation, system, seconds, seed) if named else excitation
        self.joints, self.count = system.joints, len(system.commands)
        self.q, self.v = list(self.drive.start), [0.0] * self.joints
        self.slow = [[self.drive.rest[k]] * len(unit.lags[k]) for k in range(self.count)]
        self.acting = list(self.drive.rest)
        self.loads = [unit.load_on(j, self.q[j]) for j in range(self.joints)]
        self.gusty = any(kind == "turbulence" for kind, _ in unit.hidden)
        self.played = [0.0] * self.count
        constant = unit._of("low_pass").get("time_constant", 0.0)
        self.filter = constant if constant > NO_LAG else 0.0
        # Explicit steps across several time constants would blow up.
        fastest = [x for chain in unit.lags for x in chain] + ([self.filter] if self.filter > 0.0 else [])
        self.longest = min([STEP, *fastest])
        self.seen = [*self.q, *self.v]
        self.t, self.gust = 0.0, [0.0] * self.joints
        self.pending: deque[tuple[float, list[float]]] = deque()
        self.stamps: list[float] = []
        self.readings: list[list[float]] = []
        self.sent: list[tuple[float, list[float]]] = []

    def run(self) -> None:
        sample, tick = 0, 0
        while self.t <= self.seconds:
            if sample >= int(tick * SENSOR_RATE / COMMAND_RATE):
                self._command(tick / COMMAND_RATE)
                tick += 1
            self._sample()
            sample += 1
            self._advance(sample / SENSOR_RATE)

    def _command(self, t: float) -> None:
        latest = self.readings[-1] if self.readings else [*self.q, *self.v]
        wanted = self.drive(t, latest)
        limits = [(c.low, c.high) for c in self.unit.system.commands]
        sent = [min(max(u, low), high) for u, (low, high) in zip(wanted, limits, strict=True)]
        self.sent.append((t, sent))
        for k in range(self.count):
            share = self.unit._of("lost_commands", k).get("share", 0.0)
            if share and self.unit.losses.random() < share and self.t > 0.0:
                continue
            delay = self.unit._of("actuation_delay", k).get("delay", 0.0)
            self.pending.append((t + delay, [float(k), sent[k]]))
        self.pending = deque(sorted(self.pending, key=lambda item: item[0]))

    def _sample(self) -> None:
        unit, system = self.unit, self.unit.system
        state = self.seen if self.filter > 0.0 else [*self.q, *self.v]
        rng = unit.rng
        t = self.t
        jitter = unit._of("jitter").get("sd", 0.0) * rng.standard_normal()
        stamp = t + unit._of("sensing_delay").get("delay", 0.0)
        stamp *= 1.0 + unit._of("clock_skew").get("rate", 0.0)
        if self.noisy:
            stamp += jitter
        values = []
        for c, channel in enumerate(system.measurements):
            j = c % self.joints
            x = state[c] * unit._of("sensor_scale", j).get("factor", 1.0)
            if c < self.joints:
                x += unit._of("sensor_bias", j).get("angle", 0.0)
                x += unit._of("sensor_drift", j).get("rate", 0.0) * t
                if ripple := unit._of("sensor_ripple", j):
                    phase = ripple["cycles"] * self.q[j]
                    x += ripple["sine"] * math.sin(phase) + ripple["cosine"] * math.cos(phase)
                if shift := unit._of("sensor_shift", j):
                    moved = (t - shift["start"]) / shift["duration"]
                    x += shift["angle"] * min(max(moved, 0.0), 1.0)
            elif ripple := unit._of("sensor_ripple", j):
                # The speed comes from the same encoder.
                phase = ripple["cycles"] * self.q[j]
                x *= 1.0 + ripple["cycles"] * (
                    ripple["sine"] * math.cos(phase) - ripple["cosine"] * math.sin(phase)
                )
            noise = channel.noise_sd * unit._of("noise_level", channel.name).get("factor", 1.0)
            x += noise * rng.standard_normal() if self.noisy else 0.0
            x *= unit._of("channel_slip", channel.name).get("factor", 1.0)
            step = unit._of("quantisation", channel.name).get("step", 0.0)
            values.append(step * round(x / step) if step and self.noisy else x)
        last = self.stamps[-1] if self.stamps else -math.inf
        self.stamps.append(max(stamp, last + 1e-6))
        self.readings.append(values)

    def _advance(self, until: float) -> None:
        while True:
            due = self.pending[0][0] if self.pending else math.inf
            edges = [e for e in self._edges() if self.t + 1e-12 < e]
            pause = min([until, max(due, self.t), *edges])
            if pause > self.t + 1e-12:
                steps = math.ceil((pause - self.t) / self.longest - 1e-9)
                h = (pause - self.t) / steps
                for _ in range(steps):
                    self._step(h)
                self.t = pause
            if self.pending and self.pending[0][0] <= self.t + 1e-12:
                k, u = self.pending.popleft()[1]
                self._take(int(k), u)
            elif self.t >= until - 1e-12:
                return

    def _edges(self) -> list[float]:
        pushes = [v for (kind, _), v in self.unit.hidden.items() if kind == "event"]
        return [e for p in pushes for e in (p["start"], p["start"] + p["duration"])]

    def _take(self, k: int, u: float) -> None:
        width = self.unit._of("backlash", k).get("width", 0.0)
        if width:
            u = min(max(self.played[k], u - width), u + width)
            self.played[k] = u
        self.acting[k] = self.unit.delivered(k, u, self.t, u)

    def _step(self, h: float) -> None:
        if self.gusty:
            # A load that wanders with a memory of 50 ms.
            keep = math.exp(-h / 0.05)
            spread = math.sqrt(1.0 - keep * keep)
            self.gust = [keep * g + spread * self.unit.turbulence.standard_normal() for g in self.gust]
        n = self.joints
        y = [*self.q, *self.v, *(z for chain in self.slow for z in chain)]
        y += self.seen if self.filter > 0.0 else []
        k1 = self._rates(y, self.t)
        k2 = self._rates([a + 0.5 * h * b for a, b in zip(y, k1, strict=True)], self.t + 0.5 * h)
        k3 = self._rates([a + 0.5 * h * b for a, b in zip(y, k2, strict=True)], self.t + 0.5 * h)
        k4 = self._rates([a + h * b for a, b in zip(y, k3, strict=True)], self.t + h)
        y = [
            a + h / 6.0 * (b + 2.0 * c + 2.0 * d + e) for a, b, c, d, e in zip(y, k1, k2, k3, k4, strict=True)
        ]
        self.q, self.v = y[:n], y[n : 2 * n]
        at = 2 * n
        for chain in self.slow:
            chain[:] = y[at : at + len(chain)]
            at += len(chain)
        self.seen = y[at:] if self.filter > 0.0 else [*self.q, *self.v]
        self.t += h

    def _rates(self, y: list[float], t: float) -> list[float]:
        n, unit = self.joints, self.unit
        q, v = y[:n], y[n : 2 * n]
        rates, at, effort = [], 2 * n, []
        for k in range(self.count):
            given = self.acting[k]
            for constant in unit.lags[k]:
                rates.append((given - y[at]) / constant)
                given = y[at]
                at += 1
            effort.append(given)
        load = [
            0.0 if part is None else part(q[j], v[j], effort[j], t, self.gust[j])
            for j, part in enumerate(self.loads)
        ]
        result = [*v, *unit.law(q, v, effort, load), *rates]
        if self.filter > 0.0:
            result += [(x - s) / self.filter for x, s in zip([*q, *v], y[at:], strict=True)]
        return result

    def recording(self) -> Recording:
        system = self.unit.system
        stamps, readings = np.array(self.stamps), np.array(self.readings)
        times = np.array([t for t, _ in self.sent])
        channels = {}
        for k, command in enumerate(system.commands):
            slip = self.unit._of("unit_slip", k).get("factor", 1.0)
            logged = np.array([u[k] for _, u in self.sent]) / slip
            channels[command.name] = Series(times, logged, command.unit, "command")
        for c, channel in enumerate(system.measurements):
            channels[channel.name] = Series(stamps, readings[:, c], channel.unit, "measurement")
        return Recording(channels, None, system.name, {})
