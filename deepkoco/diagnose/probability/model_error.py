"""Missing loads that are no cause: a smooth function of angle, speed and effort, and a smooth function of time.

Both act on slots of the windows. The function of the motion is a weighted sum of random cosines (its weights are
coordinates shared by all windows); that of time is independent from window to window.

Source: Rahimi and Recht, Random features for large-scale kernel machines (2007).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from deepkoco.diagnose.residuals.loaded import under_loads, with_steps_for
from deepkoco.diagnose.residuals.residuals import (
    SLOTS,
    SMOOTHING_SLOTS,
    MissingTorque,
    acting_system,
    push_of,
)
from deepkoco.diagnose.verdict.findings import motion_of
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.simulate.push import Push

FEATURES = 60  # cosines of each joint
SMOOTH = 0.7  # correlation length of the function of the motion, in half ranges of the log
DOSE = 1e-4  # of a unit load, in load scales


def slot_responses(problem: FitProblem, fit: Fit) -> np.ndarray:
    """Return the whitened response (W, NM, J K) of the measurements to a load of one load scale in each slot.

    Args:
        problem: The windows.
        fit: The point of linearisation.
    """
    problem = with_steps_for(problem, SLOTS)
    windows, system = problem.windows, problem.system
    joints, lanes = system.joints, 1 + system.joints * SLOTS
    edges = np.linspace(0, windows.steps, SLOTS + 1).round().astype(int)
    push = torch.zeros(joints, lanes, len(windows), windows.steps, dtype=torch.float64)
    for j in range(joints):
        for k in range(SLOTS):
            push[j, 1 + j * SLOTS + k, :, edges[k] : edges[k + 1]] = DOSE * system.load_scales[j]
    theta = np.array([fit.values[n] for n in problem.names])
    named = {
        n: torch.tensor(fit.values[n], dtype=torch.float64) for n in problem.names if n not in Push.NAMES
    }
    had = push_of(problem, theta)
    initial = fit.state[None].repeat(lanes, 1, 1)
    push = push if had is None else push + had
    predicted = under_loads(problem, acting_system(problem, fit), named, initial, push)
    moved = (problem.weighed(predicted[1:] - predicted[0]) / DOSE).reshape(lanes - 1, len(windows), -1)
    # Where a load makes the simulation diverge, the window says nothing of it.
    moved = torch.where(torch.isfinite(moved).all(-1, keepdim=True), moved, 0.0)
    return moved.permute(1, 2, 0).numpy()


def in_time(responses: np.ndarray, joints: int) -> np.ndarray:
    """Return responses (W, NM, J K) to independent unit loads that together are smooth in time."""
    distance = np.arange(SLOTS)
    kernel = np.exp(-0.5 * ((distance[:, None] - distance) / SMOOTHING_SLOTS) ** 2)
    root = np.linalg.cholesky(kernel + 1e-6 * np.eye(SLOTS))
    return responses @ np.kron(np.eye(joints), root)


def ranges_of(problem: FitProblem, missing: Sequence[MissingTorque]) -> tuple[np.ndarray, ...]:
    """Return lowest and highest angle, speed and effort of each joint, (2, 3) each."""
    found = []
    for joint in missing:
        motion = motion_of(problem.windows, joint, problem.system)
        parts = (motion.theta, motion.omega, motion.command)
        found.append(np.array([[p.min() for p in parts], [p.max() for p in parts]]))
    return tuple(found)


def of_motion(
    problem: FitProblem,
    responses: np.ndarray,
    missing: Sequence[MissingTorque],
    ranges: Sequence[np.ndarray],
    seed: int = 0,
) -> np.ndarray:
    """Return responses (W, NM, J D) to the weights of smooth functions of angle, speed and effort.

    Args:
        problem: The windows.
        responses: (W, NM, J K) to the load in each slot.
        missing: Motion of each joint in the slots.
        ranges: Lowest and highest angle, speed and effort of each joint, the same for all logs of a unit.
        seed: Of the random cosines, the same for all logs of a unit.
    """
    rng = np.random.default_rng([seed, 51])
    found = []
    for joint, (low, high) in zip(missing, ranges, strict=True):
        motion = motion_of(problem.windows, joint, problem.system)
        wave = rng.standard_normal((3, FEATURES)) / SMOOTH
        phase = rng.uniform(0.0, 2.0 * np.pi, FEATURES)
        motions = np.stack([motion.theta, motion.omega, motion.command], -1)
        scaled = (motions - 0.5 * (low + high)) / np.maximum(0.5 * (high - low), 1e-9)
        cosine = np.sqrt(2.0 / FEATURES) * np.cos(scaled @ wave + phase)
        slots = responses[:, :, joint.joint * SLOTS : (joint.joint + 1) * SLOTS]
        found.append(slots @ cosine.reshape(len(problem.windows), SLOTS, FEATURES))
    return np.concatenate(found, axis=2)
