"""The planning methods by name. A further method is one file and one line here."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deepkoco.koopman.latent_model import LatentModel
from deepkoco.planning.along_plan import (
    AlongPlan,
    Relinearise,
    relinearise_all,
    relinearise_cost,
    relinearise_tangent,
)
from deepkoco.planning.cem import CrossEntropyMethod
from deepkoco.planning.condensed import CondensedProgram, VaryingCondensedProgram
from deepkoco.planning.config import Array, PlannerConfig, PlanningProblem
from deepkoco.planning.errors import PlannerConfigError
from deepkoco.planning.planner import Planner
from deepkoco.planning.program import Program
from deepkoco.planning.sparse import SparseProgram

Method = Callable[[LatentModel, PlanningProblem, PlannerConfig, np.random.Generator], Program]

FROZEN_FORMS = {"condensed": CondensedProgram, "sparse": SparseProgram}
LINEARISATIONS: dict[str, Callable[[LatentModel], Relinearise]] = {
    "cost_along_plan": relinearise_cost,
    "along_plan": relinearise_all,
    "tangent": relinearise_tangent,
}
VARYING_FORMS = {"condensed": VaryingCondensedProgram, "sparse": SparseProgram}


def lmpc(
    model: LatentModel, problem: PlanningProblem, config: PlannerConfig, generator: np.random.Generator
) -> Program:
    """One quadratic program per step."""
    settings = problem, config.solver, config.tolerance, config.warm_start
    if config.linearisation == "frozen":
        return FROZEN_FORMS[config.form](*settings)
    relinearise = LINEARISATIONS[config.linearisation](model)
    return AlongPlan(problem.dynamics, relinearise, VARYING_FORMS[config.form](*settings), config.horizon)


METHODS: dict[str, Method] = {"lmpc": lmpc, "cem": CrossEntropyMethod}
"""Choices of `PlannerConfig.method`."""


def make_planner(
    model: LatentModel,
    config: PlannerConfig,
    action_low: Array,
    action_high: Array,
    seed: int | tuple[int, ...] = 0,
    diagnostics: bool = False,
) -> Planner:
    """Make the planner of one control loop.

    Args:
        model: Gives dynamics, R and r, and B and C at further points where the method asks for them.
        config: Settings.
        action_low: a_min (M,).
        action_high: a_max (M,).
        seed: Of methods that draw samples.
        diagnostics: Collect all of `Planner.statistics`.

    Returns:
        The planner.

    Raises:
        PlannerConfigError: A setting is out of range or does not go with the model.
        UnknownSolverError: The solver is not installed.
    """
    config.check()
    if len(config.increment_units) not in (0, model.action_size):
        raise PlannerConfigError(
            f"planner.increment_units = {list(config.increment_units)}; give one for each of "
            f"{model.action_size} actions"
        )
    problem = PlanningProblem(
        model.dynamics,
        np.asarray(action_low, np.float64),
        np.asarray(action_high, np.float64),
        model.action_weight,
        config.increment_weights,
        config.horizon,
        model.cost_rank,
    )
    program = METHODS[config.method](model, problem, config, np.random.default_rng(seed))
    return Planner(program, problem.action_low, problem.action_high, diagnostics)
