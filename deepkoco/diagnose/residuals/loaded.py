"""Simulations of windows under outside loads at one model, several threads at once."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from deepkoco.fit.fit import FitProblem
from deepkoco.fit.simulate.simulator import is_compiled, predict
from deepkoco.fit.threads import in_parts
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

    def simulate(at: int, end: int) -> None:
        result[at:end] = predict(system, problem.windows, named, initial[at:end], push[:, at:end])

    in_parts(simulate, lanes, problem.lanes_each)
    return result
