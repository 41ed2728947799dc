"""Finite differences of simulations in parameters and initial states, as lanes of one batch.

Many parameters of a robot have almost the same effect: a motion hardly tells a weaker motor from heavier links. What
tells them apart is a small difference of large slopes. An error of a thousandth of a slope then counts as information
where there is none, and holds a fit in the middle of a valley. So the size of the differences is chosen by what the
simulation shows (:func:`difference_size`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.shooting import ShootingProblem

POSITION_STEP, SPEED_STEP = 1e-6, 1e-5  # finite differences of the initial state [rad or m, per s]
PARAMETER_STEP = 1e-5  # finite difference of a parameter, relative to its scale
# Where several joints stick and turn, a simulation has small jumps: another joint turns first, in another step. A jump
# of a tenth of the noise across a small difference is a slope that outweighs all others; across a large one it is not.
MANY_STATES = 8
COARSER = 100.0  # larger differences with so many states


# Sizes that are tried, as shares of a parameter's scale.
SIZES = (COARSER * PARAMETER_STEP, PARAMETER_STEP, PARAMETER_STEP / COARSER)


def state_steps(states: int, size: float | None = None) -> tuple[float, ...]:
    """Finite differences of an initial state: positions first, then speeds.

    Args:
        states: Number of states.
        size: Of the finite differences of parameters; None for the usual one.
    """
    more = (parameter_step(states) if size is None else size) / PARAMETER_STEP
    return (more * POSITION_STEP,) * (states // 2) + (more * SPEED_STEP,) * (states // 2)


def parameter_step(states: int) -> float:
    """Finite difference of a parameter, relative to its scale, of a system with so many states."""
    return COARSER * PARAMETER_STEP if states >= MANY_STATES else PARAMETER_STEP


@dataclass(frozen=True)
class Tangent:
    """Lanes to simulate around one point: the point, one for each of q parameters, one for each of S states.

    Attributes:
        theta: (1 + q + S, P) parameters of each lane.
        state: (1 + q + S, W, S) initial states of each lane.
        steps: (q + S,) by how much each lane but the first is moved; negative where a step up would leave the bounds.
    """

    theta: np.ndarray
    state: Tensor
    steps: Tensor

    @staticmethod
    def at(
        problem: ShootingProblem,
        theta: np.ndarray,
        columns: np.ndarray,
        state: Tensor,
        states: bool = True,
        size: float | None = None,
    ) -> Tangent:
        """Return the lanes around a point.

        Args:
            problem: Bounds and scales of the parameters.
            theta: (P,) all parameters.
            columns: (q,) numbers of those that are moved.
            state: (W, S) initial states.
            states: Whether initial states are moved too.
            size: Of the differences, as a share of a parameter's scale; None for the usual one.
        """
        step = (parameter_step(state.shape[1]) if size is None else size) * problem.scale[columns]
        step = np.where(theta[columns] + step > problem.high[columns], -step, step)
        nudge = state_steps(state.shape[1], size) if states else ()
        count = 1 + len(columns) + len(nudge)
        lanes = np.repeat(theta[None], count, axis=0)
        lanes[1 + np.arange(len(columns)), columns] += step
        starts = state[None].repeat(count, 1, 1)
        for s, size in enumerate(nudge):
            starts[1 + len(columns) + s, :, s] += size
        return Tangent(lanes, starts, torch.tensor([*step, *nudge], dtype=torch.float64))

    def __len__(self) -> int:
        """Return the number of lanes."""
        return len(self.theta)

    def slopes(self, predicted: Tensor, weight: Tensor) -> Tensor:
        """Return the whitened slopes (q + S, W, N, M), parameters first.

        Args:
            predicted: (1 + q + S, W, N, M) simulated measurements of the lanes.
            weight: (W, N, M) weights of the measurements, in one over their noise.
        """
        moved = predicted[1:] - predicted[0]
        return moved.div_(self.steps[:, None, None, None]).mul_(weight)


def batches(lanes: Sequence[int], most: int) -> list[np.ndarray]:
    """Return which tangents are simulated together: neighbours with at most so many lanes, or a single one.

    Args:
        lanes: Number of lanes of each tangent.
        most: Largest number in one batch.
    """
    result: list[list[int]] = []
    total = 0
    for i, count in enumerate(lanes):
        if not result or total + count > most:
            result.append([])
            total = 0
        result[-1].append(i)
        total += count
    return [np.array(own) for own in result]


FEW = 2  # lanes of a tangent up to which usual steps save nothing


def simulated(problem: ShootingProblem, tangents: Sequence[Tangent], nuisance: Tensor) -> Tensor:
    """Simulate the lanes of tangents: the points with the steps of the windows, the differences with usual steps.

    Args:
        problem: The problem.
        tangents: Points with their lanes.
        nuisance: (T, z) nuisances of the logs at each point.

    Returns:
        (L, W, N, M) measurements of all lanes, tangent by tangent.
    """
    theta = np.concatenate([tangent.theta for tangent in tangents])
    state = torch.cat([tangent.state for tangent in tangents])
    sizes = np.array([len(tangent) for tangent in tangents])
    owner = np.repeat(np.arange(len(tangents)), sizes)
    usual = problem.with_usual_steps
    many = (sizes > FEW)[owner]
    if usual is problem or not many.any():
        return problem.predict(theta, state, nuisance[owner])
    first = np.cumsum(sizes) - sizes
    exact = ~many
    exact[first] = True
    result = torch.empty(len(theta), *problem.windows.value.shape, dtype=torch.float64)
    one, all_of_many = torch.from_numpy(exact), torch.from_numpy(many)
    result[one] = problem.predict(theta[exact], state[one], nuisance[owner[exact]])
    roughly = usual.predict(theta[many], state[all_of_many], nuisance[owner[many]])
    _, begin, number = np.unique(owner[many], return_index=True, return_inverse=True)
    error = result[first[sizes > FEW]] - roughly[begin]
    roughly += error[number]
    result[torch.from_numpy(many & ~exact)] = roughly[torch.from_numpy(~exact[many])]
    return result


def difference_size(
    problem: ShootingProblem, theta: np.ndarray, columns: np.ndarray, state: Tensor, nuisance: Tensor
) -> float:
    """Return the size of finite differences whose slopes have the smallest error, as a share of a parameter's scale.

    The error of a one-sided slope is half of its difference from the slope to the other side. It grows with the size
    where the simulation is curved, and falls with it where the simulation jumps or is rounded.

    Args:
        problem: The problem; it keeps the answer.
        theta: (P,) all parameters.
        columns: (q,) numbers of those that are moved.
        state: (W, S) initial states.
        nuisance: (z,) nuisances of the logs.

    Source: Gill, Murray, Saunders, Wright, Computing forward-difference intervals for numerical optimization (1983).
    """
    if problem.difference is None:
        problem.difference = _difference_size(problem.with_usual_steps, theta, columns, state, nuisance)
    return problem.difference


def _difference_size(
    problem: ShootingProblem, theta: np.ndarray, columns: np.ndarray, state: Tensor, nuisance: Tensor
) -> float:
    usual, states = parameter_step(state.shape[1]), state.shape[1]
    inside = np.minimum(theta[columns] - problem.low[columns], problem.high[columns] - theta[columns])
    moved = columns[inside > usual * problem.scale[columns]]
    # All at once, and every other one the other way.
    signs = [np.ones(len(moved) + states), np.where(np.arange(len(moved) + states) % 2, -1.0, 1.0)]
    lanes, starts = [theta], [state]
    for size in SIZES:
        nudge = np.array(state_steps(states, size))
        for sign in signs:
            for side in (-1.0, 1.0):
                lane = theta.copy()
                lane[moved] += side * sign[: len(moved)] * size * problem.scale[moved]
                lanes.append(lane)
                starts.append(state + torch.from_numpy(side * sign[len(moved) :] * nudge))
    shown = problem.predict(np.array(lanes), torch.stack(starts), nuisance[None].expand(len(lanes), -1))
    both = shown[1:].unflatten(0, (len(SIZES), len(signs), 2))
    second = (both.sum(2) - 2.0 * shown[0]) * problem.weight
    errors = (second**2).flatten(1).sum(1).sqrt() / torch.tensor(SIZES, dtype=torch.float64)
    if not bool(torch.isfinite(errors).any()):
        return usual
    return SIZES[int(errors.nan_to_num(torch.inf).argmin())]
