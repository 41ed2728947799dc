"""Strength ES of a hidden effect in a log of MuJoCo, and effects of a wanted strength.

ES is the root mean square of what the healthy unit cannot explain, in standard deviations of the noise: the healthy
unit replays the sent commands in windows, each from the initial state that fits best.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from tests.oracle.mujoco_robots import Robot
from tests.oracle.mujoco_unit import Hidden, Log, joint_names, record, unit_model

WINDOW = 1.0  # [s]
WINDOWS = 6
COARSE = 5e-4  # step of a dosing run and of its replay [s]
NUDGE = 1e-5
LONGEST_MOVE = 0.2  # of one coordinate of an initial state in one step [rad, m, and per second]
INVISIBLE = 0.05  # ES below which a dose does nothing that the log shows
STRONGEST_DOSE = 30.0


def strength(log: Log, seed: int) -> float:
    """ES of whatever is hidden in a log of the unit with this seed, recorded at the step ``COARSE``."""
    model = unit_model(log.robot, None, seed, COARSE)
    total, count = 0.0, 0
    for start, rows in windows_of(log):
        wanted = (log.clean[start : start + rows] / log.sd).ravel()
        state = log.states[start].copy()
        best = wanted - replay(model, log, state, start, rows)
        for _ in range(3):
            here = wanted - best
            slopes = np.empty((len(here), len(state)))
            for k in range(len(state)):
                moved = state.copy()
                moved[k] += NUDGE
                slopes[:, k] = (replay(model, log, moved, start, rows) - here) / NUDGE
            step = np.clip(np.linalg.lstsq(slopes, best, rcond=None)[0], -LONGEST_MOVE, LONGEST_MOVE)
            # Sticking makes a replay a kinked function of its start: only a step that helps is taken.
            for share in (1.0, 0.3, 0.1):
                left = wanted - replay(model, log, state + share * step, start, rows)
                if float(left @ left) < float(best @ best):
                    state, best = state + share * step, left
                    break
            else:
                break
        total += float(best @ best)
        count += best.size
    return math.sqrt(total / count)


def windows_of(log: Log) -> list[tuple[int, int]]:
    """First row and number of rows of the windows of a log."""
    rate = (len(log.t) - 1) / (log.t[-1] - log.t[0])
    rows = round(WINDOW * rate)
    return [(int(s), rows) for s in np.linspace(0.1 * len(log.t), len(log.t) - rows - 1, WINDOWS)]


def replay(
    model: mujoco.MjModel,
    log: Log,
    state: np.ndarray,
    start: int,
    rows: int,
    pushed: np.ndarray | None = None,
    late: np.ndarray | None = None,
) -> np.ndarray:
    """(rows * N,) noise-free readings of a unit under the sent commands, in standard deviations of the noise.

    Args:
        model: The unit.
        log: The log whose commands are sent.
        state: (2 J,) positions and speeds at the first row.
        start: First row.
        rows: Number of rows.
        pushed: (J,) constant loads on the joints [N m or N].
        late: (M,) delay of each command, less than the time between two rows [s].
    """
    data = mujoco.MjData(model)
    joints = model.njnt
    data.qpos[:], data.qvel[:] = state[:joints], state[joints:]
    if pushed is not None:
        data.qfrc_applied[:] = pushed
    rate = (len(log.t) - 1) / (log.t[-1] - log.t[0])
    steps = round(1.0 / (rate * model.opt.timestep))
    first = 0 if late is None else round(float(late.max()) / model.opt.timestep)
    result = np.zeros((rows, log.clean.shape[1]))
    for i in range(rows):
        result[i] = np.concatenate([data.qpos, data.qvel])[: result.shape[1]]
        now = log.commands[start + i]
        if late is not None and first:
            data.ctrl[:] = np.where(late > 0.0, log.commands[start + i - 1], now)
            mujoco.mj_step(model, data, first)
        data.ctrl[:] = now
        mujoco.mj_step(model, data, steps - first)
    return (result / log.sd).ravel()


def dosed(robot: Robot, kind: str, joint: str, dose: float) -> Hidden:
    """An effect at a dose: of order 1 it changes the motion of that joint visibly.

    Args:
        robot: The robot.
        kind: Kind of the effect.
        joint: Its joint.
        dose: Above 0.
    """
    model = mujoco.MjModel.from_xml_string(robot.xml)
    j = joint_names(model).index(joint)
    load, inertia, carried = joint_scales(model, j)
    size = {
        "frictionloss": 0.05 * load * dose,
        "damping": 0.03 * load * dose,
        "armature": 0.1 * inertia * dose,
        "payload": 0.05 * carried * dose,
        "gain": 1.0 / (1.0 + 0.1 * dose),
        "torque_bias": 0.05 * load * dose,
        "delay": 0.01 * dose,
        "sensor_bias": 0.02 * dose,
        "sensor_scale": 1.0 + 0.01 * dose,
        "spring": 0.1 * load * dose,
    }[kind]
    return Hidden(kind, joint, size)


def joint_scales(model: mujoco.MjModel, j: int) -> tuple[float, float, float]:
    """Torque or force that moves a joint at 1 g, its inertia, and the mass that it carries."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    column, unit = np.zeros(model.nv), np.zeros(model.nv)
    unit[j] = 1.0
    mujoco.mj_mulM(model, data, column, unit)
    inertia = float(column[j])
    carried = float(model.body_subtreemass[model.jnt_bodyid[j]])
    slides = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
    return (9.81 * carried if slides else 9.81 * math.sqrt(inertia * carried)), inertia, carried


def scaled(
    robot: Robot, kind: str, joint: str, seed: int, seconds: float, wanted: float
) -> tuple[Hidden, float] | None:
    """An effect at about the wanted ES, and the ES that it really has; None if it cannot be seen.

    Args:
        robot: The robot.
        kind: Kind of the effect.
        joint: Its joint.
        seed: Of unit, excitation and noise.
        seconds: Length of the log [s].
        wanted: ES.
    """
    dose = 1.0
    best: tuple[Hidden, float] | None = None
    for _ in range(5):
        hidden = dosed(robot, kind, joint, dose)
        log = record(robot, hidden, seed, seconds, step=COARSE)
        found = strength(log, seed)
        if best is None or abs(found - wanted) < abs(best[1] - wanted):
            best = (hidden, found)
        if 0.75 * wanted < found < 1.33 * wanted:
            break
        dose *= float(np.clip(wanted / max(found, 1e-3), 0.05, 8.0))
        if dose > STRONGEST_DOSE:
            break
    assert best is not None
    return best if best[1] > max(INVISIBLE, 0.3 * wanted) else None
