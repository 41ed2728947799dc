"""Log of a robot that MuJoCo simulates, with one hidden effect at one place: none of the package's dynamics is used.

MuJoCo steps finely with its Runge-Kutta integrator. Its dry friction is made nearly rigid, so that a joint that sticks
does not creep.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import yaml

from tests.oracle.mujoco_drives import make_drive
from tests.oracle.mujoco_robots import Robot

# MuJoCo's other integrators are of first order: a step of h shifts a motion by about h / 2. At 50 us they were off by 6
# standard deviations of an encoder of 65536 ticks in a turn, in a window where the motion makes errors large.
STEP = 5e-5  # of the unit's simulation [s]
TICKS = (4096, 16384, 65536)  # of an encoder in one turn
SLIDE_TICK = 5e-5  # of an encoder of a rail [m]
BLUR = 0.4  # standard deviation of the noise of a position, in ticks
KINDS = (
    "frictionloss",
    "damping",
    "armature",
    "payload",
    "gain",
    "torque_bias",
    "delay",
    "sensor_bias",
    "sensor_scale",
    "spring",
)


@dataclass(frozen=True)
class Hidden:
    """One effect at one place.

    Attributes:
        kind: One of ``KINDS``.
        joint: Name of its joint; of a payload, the joint whose body carries it.
        size: Friction [N m], damping [N m s/rad], armature [kg m2], mass [kg], factor of the actuator's gain, torque
            [N m], delay [s], angle [rad], factor of the reading, or stiffness [N m/rad]; in N and m on a slide.
    """

    kind: str
    joint: str
    size: float


@dataclass(frozen=True)
class Sensors:
    """Rate, resolution and noise of the sensors of a log.

    Attributes:
        rate: Of the rows of the log [Hz].
        tick: Joint -> step to which its position is rounded [rad or m].
        speed_sd: Joint -> standard deviation of its measured speed; empty where speeds are not logged.
    """

    rate: float
    tick: Mapping[str, float]
    speed_sd: Mapping[str, float]

    def position_sd(self, joint: str) -> float:
        """Standard deviation of a position: noise and rounding."""
        return self.tick[joint] * math.sqrt(BLUR**2 + 1.0 / 12.0)


@dataclass(frozen=True)
class Log:
    """What the unit did.

    Attributes:
        t: (n,) stamps [s].
        commands: (n, M) as sent.
        readings: (n, N) as logged: positions, then speeds where they are logged.
        clean: (n, N) the same without noise and rounding.
        states: (n, 2 J) true positions and speeds.
        names: Columns of ``readings``.
        sd: (N,) standard deviation of the noise of each column.
        robot: The model as the user has it.
        units: Column -> unit, of commands and readings.
    """

    t: np.ndarray
    commands: np.ndarray
    readings: np.ndarray
    clean: np.ndarray
    states: np.ndarray
    names: tuple[str, ...]
    sd: np.ndarray
    robot: Robot
    units: Mapping[str, str] = field(default_factory=dict)

    def write(self, folder: Path, name: str) -> Path:
        """Write log, sidecar and model; return the path of the log.

        Args:
            folder: An existing folder.
            name: Name of the log without ending.
        """
        commands = [n for n in self.units if n not in self.names]
        header = ",".join(["t", *commands, *self.names])
        table = np.column_stack([self.t, self.commands, self.readings])
        path = folder / f"{name}.csv"
        np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")
        channels = {
            n: {"column": n, "unit": u, "kind": "command" if n in commands else "measurement"}
            for n, u in self.units.items()
        }
        sidecar = {"time": {"column": "t", "unit": "s"}, "channels": channels}
        path.with_suffix(".yaml").write_text(yaml.safe_dump(sidecar, sort_keys=False))
        (folder / f"{name}.xml").write_text(self.robot.xml)
        return path


def draw_sensors(rng: np.random.Generator, model: mujoco.MjModel) -> Sensors:
    """Draw rate, encoders and, for half of the logs, tachometers."""
    turn = 2.0 * math.pi / float(rng.choice(TICKS))
    names = joint_names(model)
    slides = [model.joint(n).type[0] == mujoco.mjtJoint.mjJNT_SLIDE for n in names]
    tick = {n: SLIDE_TICK if s else turn for n, s in zip(names, slides, strict=True)}
    speeds = {n: 0.01 if s else 0.02 for n, s in zip(names, slides, strict=True)}
    return Sensors(float(rng.choice([100.0, 200.0])), tick, speeds if rng.random() < 0.5 else {})


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the joints in the order of the coordinates."""
    return tuple(model.joint(j).name for j in range(model.njnt))


def unit_model(
    robot: Robot,
    hidden: Hidden | None,
    seed: int,
    step: float = STEP,
    off: Callable[[np.random.Generator], float] | None = None,
) -> mujoco.MjModel:
    """Compile the unit: the user's model with small deviations of its own, and with the hidden effect.

    Args:
        robot: The model as the user has it.
        hidden: The effect; None for a healthy unit. What is no parameter of a model is left to `record`.
        seed: Of the deviations: every unit differs a little from its data sheet.
        step: Of the simulation [s].
        off: Draws the factor by which a value differs from its data sheet; None draws with a standard deviation of
            2 % for masses and of 5 % for friction and armature.
    """
    spec = mujoco.MjSpec.from_string(robot.xml)
    if hidden is not None and hidden.kind == "payload":
        carrier = spec.joint(hidden.joint).parent
        # Beyond the centre of mass, on the far side from the joint.
        load = carrier.add_body(name="hidden_payload", pos=[1.7 * x for x in carrier.ipos])
        load.mass, load.inertia, load.explicitinertial = hidden.size, [1e-8] * 3, True
        load.ipos = [0.0] * 3  # if it is not given, the compiler takes `pos` once more
    model = spec.compile()
    rng = np.random.default_rng([seed, 11])
    own = [b for b in range(1, model.nbody) if model.body(b).name != "hidden_payload"]
    for b in own:
        factor = 1.0 + 0.02 * float(np.clip(rng.standard_normal(), -2.0, 2.0)) if off is None else off(rng)
        model.body_mass[b] *= factor
        model.body_inertia[b] *= factor
    for values in (model.dof_damping, model.dof_frictionloss, model.dof_armature):
        if off is None:
            values *= 1.0 + 0.05 * np.clip(rng.standard_normal(model.nv), -2.0, 2.0)
        else:
            values *= [off(rng) for _ in range(model.nv)]
    model.opt.timestep = step
    # The coarse runs that find a dose are compared with replays of their own kind, and need not be exact.
    kinds = mujoco.mjtIntegrator
    model.opt.integrator = kinds.mjINT_RK4 if step <= STEP else kinds.mjINT_IMPLICITFAST
    model.opt.iterations, model.opt.tolerance = 50, 1e-12
    model.dof_solimp[:, :2] = 0.9999
    model.dof_solref[:, 0] = 2.0 * step
    if hidden is not None:
        _hide(model, hidden)
    return model


def _hide(model: mujoco.MjModel, hidden: Hidden) -> None:
    joint = model.joint(hidden.joint).id
    if hidden.kind == "frictionloss":
        model.dof_frictionloss[joint] += hidden.size
    elif hidden.kind == "damping":
        model.dof_damping[joint] += hidden.size
    elif hidden.kind == "armature":
        model.dof_armature[joint] += hidden.size
    elif hidden.kind == "spring":
        model.jnt_stiffness[joint] = hidden.size
        model.qpos_spring[joint] = 0.0
    elif hidden.kind == "gain":
        for k in range(model.nu):
            if model.actuator_trnid[k, 0] == joint:
                model.actuator_gainprm[k] *= hidden.size
                model.actuator_biasprm[k] *= hidden.size


def record(
    robot: Robot,
    hidden: Hidden | None,
    seed: int,
    seconds: float = 20.0,
    drawn: int | None = None,
    step: float = STEP,
    off: Callable[[np.random.Generator], float] | None = None,
) -> Log:
    """Run the unit under its excitation and log it.

    Args:
        robot: The model as the user has it.
        hidden: The effect; None for a healthy unit.
        seed: Of the unit, its sensors and its excitation.
        seconds: Length of the log [s].
        drawn: Seed of excitation and noise, where they shall differ from the unit's; None takes ``seed``.
        step: Of the simulation [s].
        off: As in `unit_model`.
    """
    model = unit_model(robot, hidden, seed, step, off)
    data = mujoco.MjData(model)
    names = joint_names(model)
    sensors = draw_sensors(np.random.default_rng([seed, 12]), model)
    taken = seed if drawn is None else drawn
    noise = np.random.default_rng([taken, 13])
    drive = make_drive(robot, np.random.default_rng([taken, 14]), seconds, sensors.rate)
    kind, joint = ("", -1) if hidden is None else (hidden.kind, names.index(hidden.joint))
    size = 0.0 if hidden is None else hidden.size
    if kind == "torque_bias":
        data.qfrc_applied[joint] = size
    late = np.zeros(model.nu)
    if kind == "delay":
        late[model.actuator_trnid[:, 0] == joint] = size
    tick = np.array([sensors.tick[n] for n in names])
    speed_sd = np.array([sensors.speed_sd.get(n, 0.0) for n in names])
    count, gap = round(seconds * sensors.rate), 1.0 / sensors.rate
    steps = round(gap / step)
    sent = np.zeros((count, model.nu))
    clean = np.zeros((count, 2 * len(names)))
    shown, states = np.zeros_like(clean), np.zeros_like(clean)
    for i in range(count):
        states[i] = np.concatenate([data.qpos, data.qvel])
        clean[i] = states[i]
        if kind == "sensor_bias":
            clean[i, joint] += size
        if kind == "sensor_scale":
            clean[i, [joint, len(names) + joint]] *= size
        blurred = clean[i, : len(names)] + BLUR * tick * noise.standard_normal(len(names))
        shown[i, : len(names)] = tick * np.round(blurred / tick)
        shown[i, len(names) :] = clean[i, len(names) :] + speed_sd * noise.standard_normal(len(names))
        sent[i] = np.round(drive(i, shown[i, : len(names)]), 6)
        # Rows between two samples at which the acting command changes: at most once for each actuator.
        edges = np.unique(np.round(np.append(0.0, np.mod(late, gap)) / step)).astype(int)
        for begin, end in itertools.pairwise([*edges[edges < steps], steps]):
            now = i * gap + (begin + 0.5) * step
            acts = np.clip(np.floor((now - late) * sensors.rate + 1e-9), 0, i).astype(int)
            data.ctrl[:] = sent[acts, np.arange(model.nu)]
            mujoco.mj_step(model, data, end - begin)
    logged = np.arange(len(names) if not sensors.speed_sd else 2 * len(names))
    sd = np.array([*(sensors.position_sd(n) for n in names), *speed_sd])[logged]
    columns = (*(f"q_{n}" for n in names), *(f"dq_{n}" for n in names))
    return Log(
        np.arange(count) * gap,
        sent,
        shown[:, logged],
        clean[:, logged],
        states,
        tuple(columns[k] for k in logged),
        sd,
        robot,
        _units(model, robot, [columns[k] for k in logged]),
    )


def _units(model: mujoco.MjModel, robot: Robot, columns: list[str]) -> dict[str, str]:
    slides = {n for n in joint_names(model) if model.joint(n).type[0] == mujoco.mjtJoint.mjJNT_SLIDE}
    units = {}
    for k in range(model.nu):
        slide = model.joint(model.actuator_trnid[k, 0]).name in slides
        force, way = ("N", "m") if slide else ("N m", "rad")
        units[model.actuator(k).name] = force if robot.drive == "motor" else way
    for column in columns:
        kind, joint = column.split("_", 1)
        units[column] = ("m" if joint in slides else "rad") + ("/s" if kind == "dq" else "")
    return units
