"""Simulations of windows under outside loads at one model, several threads at once."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.fit import FitProblem
from deepkoco.fit.simulate.simulator import is_compiled, predict
from deepkoco.fit.threads import at_once
from deepkoco.systems import ExtendedSystem

EVEN = 5  # steps of a slot from which all slots are nearly of one length


def with_steps_for(problem: FitProblem, slots: int) -> FitProblem:
    """Return the same problem with the steps for responses to a load in each of so many slots of a window.

    Responses are differences of simulations, which need no cut steps; but slots consist of whole steps.
    """
    usual = problem.with_usual_steps
    steps = usual.windows.steps
    return usual if steps % slots == 0 or steps >= EVEN * slots else problem


def under_loads(
    problem: FitProblem, system: ExtendedSystem, named: Mapping[str, Tensor], initial: Tensor, push: Tensor
) -> Tensor:
    """Return simulated measurements (L, W, N, M).

    Args:
        problem: W windows of n steps.
        system: The base system with the effects that act.
        named: Its parameters, each a scalar.
        initial: (L, W, S) states at the start of the windows.
        push: (J, L, W, n) load on each joint over each step [N m or N].
    """
    lanes = len(initial)
    if not problem.in_threads or not is_compiled(system, problem.windows.step):
        return predict(system, problem.windows, named, initial, push)
    result = torch.empty(lanes, *problem.windows.value.shape, dtype=torch.float64)
    parts = np.array_split(np.arange(lanes), math.ceil(lanes / problem.lanes_each))

    def simulate(k: int) -> None:
        at, end = int(parts[k][0]), int(parts[k][-1]) + 1
        result[at:end] = predict(system, problem.windows, named, initial[at:end], push[:, at:end])

    at_once(simulate, len(parts))
    return result
