"""Commands for robots of MuJoCo: goals of servos, torques of a loop around goals, forces on a cart."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tests.oracle.mujoco_robots import Robot, natural_frequency

EXCITATIONS = ("multisine", "steps", "waypoints")
REACH = 1.1  # of goals [rad]
SMOOTH = 0.06  # time constant of goals [s]
Drive = Callable[[int, np.ndarray], np.ndarray]  # (row, (J,) read positions) -> (M,) commands


def make_drive(robot: Robot, rng: np.random.Generator, seconds: float, rate: float) -> Drive:
    """Draw an excitation.

    Args:
        robot: The robot.
        rng: Generator of everything that is drawn.
        seconds: Length of the log [s].
        rate: Of commands and readings [Hz].
    """
    if robot.name == "cart_pole":
        return _cart(rng, seconds, rate)
    kind = str(rng.choice(EXCITATIONS))
    goals = _goals(kind, rng, len(robot.sizes), seconds, rate, natural_frequency(robot))
    if robot.drive == "position":
        return lambda row, read: goals[row]
    limit = np.array(robot.sizes)
    extra = 0.15 * limit * _held(rng, len(limit), seconds, rate, 0.1, 0.6)
    last = {"read": np.zeros(0), "speed": np.zeros(len(limit))}

    def follow(row: int, read: np.ndarray) -> np.ndarray:
        before = last["read"] if len(last["read"]) else read
        # A reading is rounded: its difference is smoothed over a few samples.
        last["speed"] = 0.7 * last["speed"] + 0.3 * (read - before) * rate
        last["read"] = read
        wanted = limit * (1.2 * (goals[row] - read) - 0.12 * last["speed"]) + extra[row]
        return np.clip(wanted, -limit, limit)

    return follow


def _goals(
    kind: str, rng: np.random.Generator, joints: int, seconds: float, rate: float, frequency: float
) -> np.ndarray:
    """(n, J) goals that begin at 0, so that no servo starts with a jump."""
    count = round(seconds * rate) + 1
    t = np.arange(count)[:, None] / rate
    if kind == "multisine":
        total = np.zeros((count, joints))
        for _ in range(1, 6):
            own = frequency * rng.uniform(0.1, 2.0, joints)
            total += rng.uniform(0.1, 0.35, joints) * np.sin(own * t + rng.uniform(0, 2 * math.pi, joints))
    elif kind == "steps":
        total = REACH * _held(rng, joints, seconds, rate, 0.4, 1.6)
    else:
        total = _waypoints(rng, joints, count, rate)
    rise = np.clip(t / 1.0, 0.0, 1.0)
    return _smoothed(np.clip(total, -REACH, REACH) * rise, 1.0 / rate)


def _smoothed(goals: np.ndarray, gap: float) -> np.ndarray:
    """Goals behind two first-order filters: a step of a radian would throw the arm."""
    keep = math.exp(-gap / SMOOTH)
    for _ in range(2):
        for row in range(1, len(goals)):
            goals[row] = keep * goals[row - 1] + (1.0 - keep) * goals[row]
    return goals


def _waypoints(rng: np.random.Generator, joints: int, count: int, rate: float) -> np.ndarray:
    """Straight lines between points, with stops there: a joint often waits while others move."""
    goals = np.zeros((count, joints))
    for j in range(joints):
        row, at = 0, 0.0
        while row < count:
            to = float(rng.uniform(-REACH, REACH))
            way = max(int(rate * abs(to - at) / rng.uniform(0.6, 2.0)), 1)
            wait = int(rate * rng.uniform(0.0, 0.8))
            line = np.concatenate([np.linspace(at, to, way), np.full(wait, to)])[: count - row]
            goals[row : row + len(line), j] = line
            row, at = row + len(line), to
    return goals


def _cart(rng: np.random.Generator, seconds: float, rate: float) -> Drive:
    force = 4.0 * _held(rng, 1, seconds, rate, 0.1, 0.5)[:, 0]
    last = {"read": math.nan, "speed": 0.0}

    def act(row: int, read: np.ndarray) -> np.ndarray:
        before = read[0] if math.isnan(last["read"]) else last["read"]
        last["speed"] = 0.7 * last["speed"] + 0.3 * (read[0] - before) * rate
        last["read"] = read[0]
        # A rail is short: a weak spring brings the cart back.
        return np.clip([force[row] - 6.0 * read[0] - 1.0 * last["speed"]], -10.0, 10.0)

    return act


def _held(
    rng: np.random.Generator, columns: int, seconds: float, rate: float, shortest: float, longest: float
) -> np.ndarray:
    """(n, columns) piecewise constant signals between -1 and 1, each with its own switches."""
    count = round(seconds * rate) + 1
    result = np.zeros((count, columns))
    for j in range(columns):
        row = 0
        while row < count:
            until = row + max(int(rate * rng.uniform(shortest, longest)), 1)
            result[row:until, j] = rng.uniform(-1.0, 1.0)
            row = until
    return result
