"""Logs of a unit: MuJoCo moves the bodies; actuators, frictions with a memory and sensors are written out here.

No equation of the package is used. Every unit, a healthy one too, has a small model error: an actuator lag of about
1 ms, a bias and a quadratic drag of a few parts in a thousand of the load.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from deepkoco.logs.recording import Recording, Series
from deepkoco.systems.trees.mujoco_library import mujoco_library
from experiments.studies.diagnosis.hidden_cause.kinds import Hidden, place_of
from tests.oracle.mujoco_drives import make_drive
from tests.oracle.mujoco_robots import Robot, compiled
from tests.oracle.mujoco_unit import BLUR, Sensors, draw_sensors, joint_names, unit_model
from tests.oracle.mujoco_unit import Hidden as OfModel

mujoco = mujoco_library()
STEP = 2.5e-4  # of MuJoCo [s]
HOOK = 5e-4  # after which actuators and frictions are computed again [s]
PER_HOOK = round(HOOK / STEP)
OFF = (0.01, 0.03)  # by which masses, friction and armature differ from the data sheet, either way
NATIVE = {"coulomb": ("frictionloss", "level"), "damping": ("damping", "change"), "spring": ("spring", "stiffness"),
          "payload": ("payload", "mass"), "payload_dropped": ("payload", "mass")}  # fmt: skip
BEFORE_DROP = ("payload_dropped",)
ONLY_IN_TRAINING = ("push", "payload_dropped")  # what does not come again in the held-out log


class Taken(NamedTuple):
    """One log of a unit.

    Attributes:
        seed: Of its excitation and its noise.
        seconds: Its length [s].
        spread: Standard deviation by which masses and friction differ on this day, as a share.
        held_out: Whether what happened once is left out.
    """

    seed: int
    seconds: float
    spread: float = 0.0
    held_out: bool = False


class Raw(NamedTuple):
    """What a unit did: (n,) stamps, (n, M) commands, (n, N) readings, (n, 2 J) true states."""

    t: np.ndarray
    commands: np.ndarray
    readings: np.ndarray
    states: np.ndarray


class Unit:
    """A robot with the small differences that every unit has, and with a hidden cause.

    Args:
        robot: The model as given.
        hidden: What is hidden; None for a healthy unit.
        seed: Of the differences and of the sensors.
        differentiated: Whether its speeds are differences of encoder positions.
    """

    def __init__(self, robot: Robot, hidden: Hidden | None, seed: int, differentiated: bool = False) -> None:
        self.robot, self.hidden, self.seed = robot, hidden, seed
        self.differentiated = differentiated or (hidden is not None and hidden.kind == "differentiated")
        self.names = joint_names(compiled(robot))
        rng = np.random.default_rng([seed, 41])
        self.lag = float(rng.uniform(5e-4, 1.5e-3))
        places = [place_of(robot, n, 1.0) for n in self.names]
        self.loads = [p.load for p in places]
        self.bias = [0.003 * load * float(rng.uniform(-1, 1)) for load in self.loads]
        # At the speed of a fall a pole spins with 15 rad/s: the share holds there, not at 1 rad/s.
        fast = [1.0 if p.slides else max(1.0, 2.0 * p.load / p.inertia) for p in places]
        self.drag = [
            0.002 * load * float(rng.uniform(0, 1)) / v2 for load, v2 in zip(self.loads, fast, strict=True)
        ]
        sensors = draw_sensors(np.random.default_rng([seed, 12]), compiled(robot))
        if self.differentiated:
            sensors = replace(sensors, speed_sd=dict.fromkeys(self.names, 0.0))
        self.sensors: Sensors = sensors

    def record(self, taken: Taken) -> Raw:
        """Run the unit under a drawn excitation and log it."""
        log_rng = np.random.default_rng([taken.seed, 42])
        own = self._on_that_day(taken)
        drive = make_drive(
            self.robot, np.random.default_rng([taken.seed, 14]), taken.seconds, self.sensors.rate
        )
        tick = np.array([self.sensors.tick[n] for n in self.names])
        speed_sd = np.array([self.sensors.speed_sd.get(n, 0.0) for n in self.names])
        count, joints = round(taken.seconds * self.sensors.rate), len(self.names)
        sent = np.zeros((count, len(self.robot.sizes)))
        states, shown = np.zeros((count, 2 * joints)), np.zeros((count, 2 * joints))
        for i in range(count):
            states[i] = own.state()
            noise = log_rng.standard_normal(2 * joints)
            shown[i, :joints] = tick * np.round((states[i, :joints] + BLUR * tick * noise[:joints]) / tick)
            shown[i, joints:] = states[i, joints:] + speed_sd * noise[joints:]
            sent[i] = np.round(drive(i, shown[i, :joints]), 6)
            own.advance(sent, i)
        t = np.arange(count) / self.sensors.rate
        if self.differentiated:
            shown[1:, joints:] = np.diff(shown[:, :joints], axis=0) * self.sensors.rate
            shown[0, joints:] = 0.0
        kept = 2 * joints if self.sensors.speed_sd else joints
        return Raw(t, sent, shown[:, :kept], states)

    def recording(self, taken: Taken) -> Recording:
        """A log as a user would bring it."""
        raw, model = self.record(taken), compiled(self.robot)
        slides = {n for n in self.names if model.joint(n).type[0] == mujoco.mjtJoint.mjJNT_SLIDE}
        stamps = raw.t
        if self.hidden is not None and self.hidden.kind == "jitter":
            late = np.random.default_rng([taken.seed, 43]).standard_normal(len(stamps))
            stamps = np.sort(stamps + self.hidden.sizes["sd"] * late)
            stamps = stamps + 1e-7 * np.arange(len(stamps))
        channels = {}
        for k in range(model.nu):
            slide = model.joint(model.actuator_trnid[k, 0]).name in slides
            unit = ("N" if slide else "N m") if self.robot.drive == "motor" else ("m" if slide else "rad")
            channels[model.actuator(k).name] = Series(raw.t, raw.commands[:, k], unit, "command")
        for c in range(raw.readings.shape[1]):
            joint = self.names[c % len(self.names)]
            unit = ("m" if joint in slides else "rad") + ("" if c < len(self.names) else "/s")
            title = ("q_" if c < len(self.names) else "dq_") + joint
            channels[title] = Series(stamps, raw.readings[:, c], unit, "measurement")
        return Recording(channels, None, None, {})

    def strength(self, raw: Raw, taken: Taken, windows: int = 6, length: float = 1.0) -> float:
        """Root mean square of what the cause does in a second, in standard deviations of the position's noise.

        The same unit without the cause replays the commands from true states. Not a number for what only a sensor has.
        """
        if self.hidden is None or self.hidden.kind in ("differentiated", "jitter"):
            return math.nan
        healthy = Unit(self.robot, None, self.seed)
        rows, joints = round(length * self.sensors.rate), len(self.names)
        sd = np.array([self.sensors.position_sd(n) for n in self.names])
        starts = np.linspace(0.1 * len(raw.t), len(raw.t) - rows - 1, windows).astype(int)
        if self.hidden.kind == "push":
            starts = np.array([int(self.hidden.sizes["from"] * self.sensors.rate)])
            starts = np.clip(starts, 0, len(raw.t) - rows - 1)
        total = 0.0
        for start in starts:
            own = healthy._on_that_day(taken)
            own.put(raw.states[start], raw.commands[start])
            for i in range(start, start + rows):
                total += float((((own.state() - raw.states[i])[:joints] / sd) ** 2).sum())
                own.advance(raw.commands, i)
        return math.sqrt(total / (len(starts) * rows * joints))

    def _on_that_day(self, taken: Taken) -> Motion:
        once = self.hidden is not None and self.hidden.kind in ONLY_IN_TRAINING and taken.held_out
        hidden = None if once else self.hidden
        robot = (
            self.robot
            if hidden is None or hidden.kind != "elastic"
            else _with_flexible_joint(self.robot, hidden)
        )
        native = None
        if hidden is not None and hidden.kind in NATIVE:
            kind, size = NATIVE[hidden.kind]
            native = OfModel(kind, hidden.joint, hidden.sizes[size])

        def model_of(what: OfModel | None) -> Any:
            model = unit_model(robot, what, self.seed, STEP, _off)
            day = np.random.default_rng([taken.seed, 44])
            for values in (model.body_mass, model.dof_damping, model.dof_frictionloss):
                factor = 1.0 + taken.spread * np.clip(day.standard_normal(len(values)), -2.0, 2.0)
                if values is model.body_mass:
                    model.body_inertia *= factor[:, None]
                values *= factor
            return model

        later = model_of(None) if hidden is not None and hidden.kind in BEFORE_DROP else None
        return Motion(self, model_of(native), hidden, later)


class Motion:
    """A unit that moves: bodies, actuators, frictions with a memory, pushes."""

    def __init__(self, unit: Unit, model: Any, hidden: Hidden | None, later: Any | None) -> None:
        self.unit, self.model, self.later, self.hidden = unit, model, later, hidden
        self.data, self.time = mujoco.MjData(model), 0.0
        self.at = [int(model.joint(n).qposadr[0]) for n in unit.names]
        self.kind = "" if hidden is None else hidden.kind
        self.sizes = {} if hidden is None else dict(hidden.sizes)
        self.joint = -1 if hidden is None else unit.names.index(hidden.joint)
        given = compiled(unit.robot)
        self.drives = [
            unit.names.index(given.joint(given.actuator_trnid[k, 0]).name) for k in range(given.nu)
        ]
        self.gains = [
            (g[0], -b[1], -b[2]) for g, b in zip(given.actuator_gainprm, given.actuator_biasprm, strict=True)
        ]
        self.command_range, self.force_range = (
            given.actuator_ctrlrange.copy(),
            given.actuator_forcerange.copy(),
        )
        self.limited = given.actuator_forcelimited.astype(bool)
        self.model.actuator_gainprm[:] = 0.0
        self.model.actuator_biasprm[:] = 0.0
        if later is not None:
            later.actuator_gainprm[:] = 0.0
            later.actuator_biasprm[:] = 0.0
        self.force = [0.0] * given.nu
        self.slow = [0.0] * given.nu
        self.bend, self.supply = 0.0, 0.0
        inertia = place_of(unit.robot, unit.names[self.joint], 1.0).inertia if self.kind == "lugre" else 0.0
        stiffness = self.sizes["level"] / self.sizes["way"] if self.kind in ("lugre", "dahl") else 0.0
        self.micro = self.sizes.get("damping", 0.0) * 2.0 * math.sqrt(stiffness * inertia)
        self.keep = math.exp(-HOOK / unit.lag)

    def state(self) -> np.ndarray:
        """(2 J,) true positions and speeds of the given joints."""
        return np.concatenate([self.data.qpos[self.at], self.data.qvel[self.at]])

    def put(self, state: np.ndarray, command: np.ndarray) -> None:
        """Start at a state, with an actuator that has long had a command."""
        joints = len(self.at)
        self.data.qpos[self.at], self.data.qvel[self.at] = state[:joints], state[joints:]
        self.slow = [float(u) for u in command]
        self.force = [self._law(k, float(u), self.data.qpos, self.data.qvel) for k, u in enumerate(command)]

    def advance(self, sent: np.ndarray, row: int) -> None:
        """Run from one sample to the next under the commands that were sent up to a row."""
        rate = self.unit.sensors.rate
        for h in range(round(1.0 / (rate * HOOK))):
            now = row / rate + h * HOOK
            late = self.sizes["delay"] if self.kind == "delay" else 0.0
            late_row = min(max(math.floor((now + 0.5 * HOOK - late) * rate + 1e-9), 0), row)
            commands = [
                float(sent[late_row if j == self.joint else row, k]) for k, j in enumerate(self.drives)
            ]
            self._step(commands, now)

    def _step(self, commands: list[float], now: float) -> None:
        if self.later is not None and now >= self.sizes["at"]:
            data = mujoco.MjData(self.later)
            data.qpos[:], data.qvel[:] = self.data.qpos, self.data.qvel
            self.model, self.data, self.later = self.later, data, None
        data, unit = self.data, self.unit
        load = list(unit.bias)
        for j, place in enumerate(self.at):
            v = float(data.qvel[place])
            load[j] -= unit.drag[j] * v * abs(v)
        for k, j in enumerate(self.drives):
            wanted = self._law(k, self._command(k, j, commands[k]), data.qpos, data.qvel)
            self.force[k] = wanted + (self.force[k] - wanted) * self.keep
            force = self._delivered(k, j, float(data.qvel[self.at[j]]))
            load[j] += force
            if self.kind == "crosstalk" and j == self.joint:
                load[1 - j] += self.sizes["share"] * force * unit.loads[1 - j] / unit.loads[j]
        if self.joint >= 0:
            place = self.at[self.joint]
            load[self.joint] += self._extra(float(data.qpos[place]), float(data.qvel[place]), now)
        for j, place in enumerate(self.at):
            data.qfrc_applied[place] = load[j]
        mujoco.mj_step(self.model, data, PER_HOOK)

    def _command(self, k: int, j: int, command: float) -> float:
        low, high = self.command_range[k]
        command = min(max(command, low), high) if high > low else command
        if self.kind != "rate_limit" or j != self.joint:
            return command
        most = self.sizes["limit"] * HOOK
        self.slow[k] += min(max(command - self.slow[k], -most), most)
        return self.slow[k]

    def _law(self, k: int, command: float, q: np.ndarray, v: np.ndarray) -> float:
        gain, kp, kv = self.gains[k]
        place = self.at[self.drives[k]]
        force = gain * command - kp * float(q[place]) - kv * float(v[place])
        if self.kind == "gain" and self.drives[k] == self.joint:
            force *= self.sizes["factor"]
        low, high = self.force_range[k]
        return min(max(force, low), high) if self.limited[k] else force

    def _delivered(self, k: int, j: int, speed: float) -> float:
        force = self.force[k]
        if j != self.joint:
            return force
        if self.kind == "supply_sag":
            # The voltage falls with the current that is drawn, behind a capacitor.
            drawn = min(abs(force) / (1.5 * self.unit.loads[j]), 1.0)
            self.supply += (drawn - self.supply) * HOOK / self.sizes["time"]
            return force * (1.0 - self.sizes["share"] * self.supply)
        if self.kind == "torque_speed":
            along = max(speed * math.copysign(1.0, force), 0.0)
            return force * max(1.0 - along / self.sizes["no_load_speed"], 0.0)
        return force

    def _extra(self, q: float, v: float, now: float) -> float:
        """Load of the hidden cause on its joint [N m or N]."""
        s = self.sizes
        if self.kind == "bias":
            return s["effort"]
        if self.kind == "one_sided_spring":
            return -s["stiffness"] * max(q - s["from"], 0.0)
        if self.kind == "push":
            return s["load"] if s["from"] <= now < s["from"] + s["lasts"] else 0.0
        if self.kind in ("lugre", "dahl"):
            # Exact over a step of constant speed. Sources: Canudas de Wit et al. 1995; Dahl 1968.
            level = s["level"] * (1.0 + (s["breakaway"] - 1.0) * math.exp(-((v / s["speed"]) ** 2)))
            stiffness = s["level"] / s["way"]
            most = math.copysign(level / stiffness, v)
            bent = most + (self.bend - most) * math.exp(-abs(v) * stiffness / level * HOOK)
            rate, self.bend = (bent - self.bend) / HOOK, bent
            return -stiffness * self.bend - self.micro * rate
        return 0.0


def _off(rng: np.random.Generator) -> float:
    return 1.0 + float(rng.uniform(*OFF)) * float(rng.choice([-1.0, 1.0]))


def _with_flexible_joint(robot: Robot, hidden: Hidden) -> Robot:
    """The joint turns the rotor alone; its link follows by a spring, on a second joint about the same axis."""
    place = place_of(robot, hidden.joint, 1.0)
    stiffness = place.inertia * hidden.sizes["frequency"] ** 2
    spec = mujoco.MjSpec.from_string(robot.xml)
    joint = spec.joint(hidden.joint)
    flexible = joint.parent.add_joint(name="hidden_flex", type=joint.type, axis=joint.axis)
    flexible.stiffness[0] = stiffness
    flexible.damping[0] = 2.0 * hidden.sizes["ratio"] * math.sqrt(stiffness * place.inertia)
    spec.compile()
    return replace(robot, xml=spec.to_xml())
