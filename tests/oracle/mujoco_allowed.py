"""How far a log with a hidden effect is from everything that the user's own model allows.

A model file states its values with an uncertainty: a mass to 10 %, a damping to 50 %. A hidden effect that other values
within these uncertainties show as well is no fault that a log can tell: with a mass known to 10 %, a cart that is 12 %
heavier is a healthy cart. The unit's own parameters are therefore fitted to the noise-free log with their priors, and
what this fit costs is what a diagnosis can know.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import mujoco
import numpy as np

from tests.oracle.mujoco_doses import COARSE, NUDGE, replay, windows_of
from tests.oracle.mujoco_robots import Robot
from tests.oracle.mujoco_unit import Hidden, Log, joint_names, record, unit_model

# Standard deviations as shares of the model's values; those of a centre of mass in radii of gyration.
SHARES = {"mass": 0.1, "com": 0.1, "inertia": 0.2, "damping": 0.5, "frictionloss": 0.5, "armature": 0.3}
DRIVES = {"gain": 0.2, "kp": 0.2, "kv": 0.3}
STEP = 1e-5  # of a parameter [standard deviations]
# Share of the effect: the motion is linear in so little of it, and the cost grows with the square of the size.
DOSE = 1e-6

Change = Callable[[mujoco.MjModel, float], None]  # of a model by so many standard deviations


def cost_within_priors(robot: Robot, hidden: Hidden, seed: int, seconds: float) -> float:
    """Least sum of chi2 and squared prior deviations with which the healthy unit explains a log with a hidden effect.

    It is that of six windows of one second, each with its own initial state, and linear in effect and parameters. One
    standard deviation of one parameter costs 1.

    Args:
        robot: The robot.
        hidden: The effect.
        seed: Of unit, excitation and noise.
        seconds: Length of the log [s].
    """
    log = record(robot, None, seed, seconds, step=COARSE)
    model = unit_model(robot, None, seed, COARSE)
    changes = parameter_changes(robot, model)
    pairs = [[_changed(model, change, sign * STEP) for sign in (1.0, -1.0)] for change in changes]
    matrix, right, total = np.eye(len(changes)), np.zeros(len(changes)), 0.0
    for start, rows in windows_of(log):
        state = log.states[start]
        moves = NUDGE * np.eye(len(state))
        by_state = np.column_stack(
            [
                replay(model, log, state + m, start, rows) - replay(model, log, state - m, start, rows)
                for m in moves
            ]
        )
        basis = np.linalg.qr(by_state)[0]
        slopes = np.column_stack(
            [
                (replay(up, log, state, start, rows) - replay(down, log, state, start, rows)) / (2.0 * STEP)
                for up, down in pairs
            ]
        )
        shown = _shown(model, log, hidden, seed, start, rows)
        slopes -= basis @ (basis.T @ slopes)
        shown -= basis @ (basis.T @ shown)
        matrix += slopes.T @ slopes
        right += slopes.T @ shown
        total += float(shown @ shown)
    return total - float(right @ np.linalg.solve(matrix, right))


def _shown(model: mujoco.MjModel, log: Log, hidden: Hidden, seed: int, start: int, rows: int) -> np.ndarray:
    """(rows * N,) what an effect adds to the readings, to first order, in standard deviations of the noise."""
    joint, state = joint_names(model).index(hidden.joint), log.states[start]
    before = replay(model, log, state, start, rows)
    if hidden.kind in ("sensor_bias", "sensor_scale"):
        table = (before * np.tile(log.sd, rows)).reshape(rows, -1)
        added = np.zeros_like(table)
        if hidden.kind == "sensor_bias":
            added[:, joint] = hidden.size
        else:
            for column in range(joint, table.shape[1], model.njnt):
                added[:, column] = (hidden.size - 1.0) * table[:, column]
        return (added / log.sd).ravel()
    if hidden.kind == "delay":
        late = np.where(model.actuator_trnid[:, 0] == joint, COARSE, 0.0)
        return (replay(model, log, state, start, rows, late=late) - before) * (hidden.size / COARSE)
    if hidden.kind == "torque_bias":
        pushed = np.zeros(model.nv)
        pushed[joint] = DOSE * hidden.size
        return (replay(model, log, state, start, rows, pushed) - before) / DOSE
    null = 1.0 if hidden.kind == "gain" else 0.0
    little = Hidden(hidden.kind, hidden.joint, null + DOSE * (hidden.size - null))
    after = replay(unit_model(log.robot, little, seed, COARSE), log, state, start, rows)
    return (after - before) / DOSE


def parameter_changes(robot: Robot, model: mujoco.MjModel) -> list[Change]:
    """Changes of every parameter of a model that is not zero, by standard deviations of its prior."""
    found: list[Change] = []
    for b in range(1, model.nbody):
        radius = float(np.sqrt(0.5 * model.body_inertia[b].sum() / model.body_mass[b]))
        found.append(_scaling("body_mass", b, SHARES["mass"]))
        found += [_shift(b, i, SHARES["com"] * radius) for i in range(3)]
        found += [_scaling("body_inertia", (b, i), SHARES["inertia"]) for i in range(3)]
    for kind in ("damping", "frictionloss", "armature"):
        values = getattr(model, f"dof_{kind}")
        found += [_scaling(f"dof_{kind}", j, SHARES[kind]) for j in range(model.nv) if values[j] > 0.0]
    for k in range(model.nu):
        if robot.drive == "motor":
            found.append(_scaling("actuator_gainprm", (k, 0), DRIVES["gain"]))
        else:
            stiffness = [
                _scaling(n, (k, i), DRIVES["kp"])
                for n, i in (("actuator_gainprm", 0), ("actuator_biasprm", 1))
            ]
            found += [_both(*stiffness), _scaling("actuator_biasprm", (k, 2), DRIVES["kv"])]
    return found


def _scaling(name: str, index: int | tuple[int, int], share: float) -> Change:
    def change(model: mujoco.MjModel, sds: float) -> None:
        getattr(model, name)[index] *= 1.0 + share * sds

    return change


def _shift(body: int, axis: int, sd: float) -> Change:
    def change(model: mujoco.MjModel, sds: float) -> None:
        model.body_ipos[body, axis] += sd * sds

    return change


def _both(first: Change, second: Change) -> Change:
    def change(model: mujoco.MjModel, sds: float) -> None:
        first(model, sds)
        second(model, sds)

    return change


def _changed(model: mujoco.MjModel, change: Change, sds: float) -> mujoco.MjModel:
    result = copy(model)
    change(result, sds)
    return result
