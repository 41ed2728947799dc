"""Finite differences of simulations in parameters and initial states, as lanes of one batch."""

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


def state_steps(states: int) -> tuple[float, ...]:
    """Finite differences of an initial state: positions first, then speeds."""
    size = COARSER if states >= MANY_STATES else 1.0
    return (size * POSITION_STEP,) * (states // 2) + (size * SPEED_STEP,) * (states // 2)


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
        problem: ShootingProblem, theta: np.ndarray, columns: np.ndarray, state: Tensor, states: bool = True
    ) -> Tangent:
        """Return the lanes around a point.

        Args:
            problem: Bounds and scales of the parameters.
            theta: (P,) all parameters.
            columns: (q,) numbers of those that are moved.
            state: (W, S) initial states.
            states: Whether initial states are moved too.
        """
        step = parameter_step(state.shape[1]) * problem.scale[columns]
        step = np.where(theta[columns] + step > problem.high[columns], -step, step)
        nudge = state_steps(state.shape[1]) if states else ()
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

    def slopes(self, predicted: Tensor, problem: ShootingProblem) -> Tensor:
        """Return the whitened slopes (q + S, W, N, M), parameters first.

        Args:
            predicted: (1 + q + S, W, N, M) simulated measurements of the lanes.
            problem: How the measurements are weighed.
        """
        moved = predicted[1:] - predicted[0]
        return problem.whitened(moved.div_(self.steps[:, None, None, None]).mul_(problem.weight))


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
