"""The unit's physics in its own time: commands go in with delay, noisy measurements come out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from random import Random

from deepkoco.unit.bodies import BODIES
from deepkoco.unit.joint import Friction, Joint
from deepkoco.unit.spec import UnitSpec

SPACING = 1e-6  # a path carries one message at a time: least time between two [s]
NO_EFFECT: Mapping[str, float] = {}


class Plant:
    """One unit between the arrival of commands and the departure of measurements.

    Time [s] starts at 0 and is whatever the caller says it is: wall-clock time in the unit's process,
    virtual time in a simulated log. The path of a command: lost, refused or cut to the limits, actuation delay, gain
    and its curvature, torque bias, dead zone, saturation, lag. The path of a measurement: scale, bias, noise,
    quantisation, sensing delay. Messages on one path never overtake each other. Once a command has come
    the next has to come within the heartbeat; otherwise the command is set to zero at once. So it is where a
    command comes that is NaN or infinite.

    Args:
        spec: The unit.
        state: Initial (angle [rad], speed [rad/s]); None takes the spec's.
        stream: Number of the random stream; a new one for every reset of a unit.
    """

    def __init__(self, spec: UnitSpec, state: tuple[float, float] | None = None, stream: int = 0) -> None:
        effects = spec.effects
        body = BODIES[spec.system](spec.parameters, effects.get("payload", NO_EFFECT).get("mass", 0.0))
        viscous = effects.get("viscous", NO_EFFECT).get("change", 0.0)
        theta, omega = spec.initial_state if state is None else state
        self.joint = Joint(
            body._replace(viscous=body.viscous + viscous),
            _friction(spec, body.coulomb),
            effects.get("lag", NO_EFFECT).get("time_constant", 0.0),
            spec.time_step,
            theta,
            omega,
        )
        self.time = 0.0
        self._spec = spec
        self._command = 0.0
        self._drive = self._actuate(0.0)
        self._arriving: deque[tuple[float, float]] = deque()  # (due, command)
        self._leaving: deque[tuple[float, int, tuple[float, ...]]] = deque()  # (due, seq, values)
        self._last_due = {"actuation_delay": -math.inf, "sensing_delay": -math.inf}
        self._deadline = math.inf  # when the heartbeat is missed
        self.stops = 0  # times that the heartbeat was missed or a command was not finite
        self._noise = Random(f"noise {spec.seed} {stream}")
        self._jitter = Random(f"jitter {spec.seed} {stream}")
        self._losses = Random(f"losses {spec.seed} {stream}")
        push = effects.get("event", {"torque": 0.0, "start": math.inf, "duration": 0.0})
        self._push = push["torque"]
        self._push_start, self._push_stop = push["start"], push["start"] + push["duration"]

    @property
    def command(self) -> float:
        """Command that acts now, before the actuator's own effects, in the command's unit."""
        return self._command

    @property
    def next_departure(self) -> float:
        """When the next measurement under way leaves the unit [s], inf if none is under way."""
        return self._leaving[0][0] if self._leaving else math.inf

    def send(self, command: float) -> None:
        """Take a command that arrives now, unless it is lost on its way: then it never was.

        NaN and infinity are refused: they stop the unit.
        """
        share = self._spec.effects.get("lost_commands", NO_EFFECT).get("share", 0.0)
        if share > 0.0 and self._losses.random() < share:
            return
        if not math.isfinite(command):
            self.refuse()
            return
        low, high = self._spec.command_limits
        self._arriving.append((self._delayed("actuation_delay"), min(max(command, low), high)))
        self._deadline = self.time + self._spec.heartbeat

    def refuse(self) -> None:
        """Stop because an order was not a finite number, and count it."""
        self.stop()
        self.stops += 1

    def stop(self) -> None:
        """Set the command to zero at once and forget those under way."""
        self._arriving.clear()
        self._deadline = math.inf
        self._set(0.0)

    def sample(self, seq: int) -> None:
        """Measure the state now; the measurement leaves after the sensing delay.

        Args:
            seq: Number of the sample, handed on with it.
        """
        effects, sensor = self._spec.effects, self._spec.sensor
        scale = effects.get("sensor_scale", NO_EFFECT).get("factor", 1.0)
        bias = effects.get("sensor_bias", NO_EFFECT).get("angle", 0.0)
        true = (scale * self.joint.theta + bias, scale * self.joint.omega)
        values = []
        for value, noise_sd, step in zip(true, sensor.noise_sd, sensor.quantisation, strict=True):
            reading = value + self._noise.gauss(0.0, noise_sd)
            values.append(step * round(reading / step) if step > 0.0 else reading)
        self._leaving.append((self._delayed("sensing_delay"), seq, tuple(values)))

    def advance(self, until: float) -> None:
        """Move on to time ``until`` [s]; a time in the past leaves the plant where it is."""
        while True:
            arrival = self._arriving[0][0] if self._arriving else math.inf
            pause = min(until, arrival, self._deadline)
            pushed = self._push_start <= self.time < self._push_stop
            if not pushed and self.time < self._push_start:
                pause = min(pause, self._push_start)
            elif pushed:
                pause = min(pause, self._push_stop)
            if pause > self.time:
                self.joint.advance(pause - self.time, self._drive, self._push if pushed else 0.0)
                self.time = pause
            if arrival <= self.time:
                self._set(self._arriving.popleft()[1])
            elif self._deadline <= self.time:
                self.stop()
                self.stops += 1
            elif self.time >= until:
                return

    def take(self) -> list[tuple[int, tuple[float, ...]]]:
        """Measurements that have left the unit by now, oldest first, as (number, values)."""
        gone = []
        while self._leaving and self._leaving[0][0] <= self.time:
            _, seq, values = self._leaving.popleft()
            gone.append((seq, values))
        return gone

    def _delayed(self, path: str) -> float:
        law = self._spec.effects.get(path)
        delay = 0.0
        if law is not None:
            # Normal, redrawn below 0: one draw where there is no jitter keeps streams comparable.
            delay = self._jitter.gauss(law["delay"], law["jitter_sd"])
            while delay < 0.0:
                delay = self._jitter.gauss(law["delay"], law["jitter_sd"])
        self._last_due[path] = max(self.time + delay, self._last_due[path] + SPACING)
        return self._last_due[path]

    def _set(self, command: float) -> None:
        self._command = command
        self._drive = self._actuate(command)

    def _actuate(self, command: float) -> float:
        effects = self._spec.effects
        if "gain" in effects:
            command *= effects["gain"]["factor"]
        if "gain_curve" in effects:
            command += effects["gain_curve"]["curvature"] * command**3
        if "torque_bias" in effects:
            command += effects["torque_bias"]["effort"]
        if "dead_zone" in effects:
            command = math.copysign(max(abs(command) - effects["dead_zone"]["width"], 0.0), command)
        if "saturation" in effects:
            limit = effects["saturation"]["limit"]
            command = min(max(command, -limit), limit)
        return command


def _friction(spec: UnitSpec, coulomb: float) -> Friction:
    effects = spec.effects
    stribeck = effects.get("stribeck", {"coulomb": 0.0, "breakaway": 0.0, "speed": 1.0})
    cogging = effects.get("cogging", {"torque": 0.0, "cycles": 0.0})
    return Friction(
        coulomb=coulomb + effects.get("coulomb", NO_EFFECT).get("torque", 0.0) + stribeck["coulomb"],
        breakaway=stribeck["breakaway"],
        speed=stribeck["speed"],
        quadratic=effects.get("quadratic", NO_EFFECT).get("drag", 0.0),
        smoothing=spec.friction_smoothing,
        cogging=cogging["torque"],
        cogging_cycles=cogging["cycles"],
    )
