"""Time per decision on one core: `python -m experiments.planner_benchmark [--json] [--model FOLDER]`.

Compares the public `act()` of each planner with building and solving the same program anew by
`qpsolvers.solve_problem` at every step, in the same process and on the same states.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import qpsolvers
import torch
from scipy import sparse

from deepkoco.agent.policy import KoopmanPolicy, load_model
from deepkoco.koopman.export import export_model
from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.koopman.model import KoopmanModel, ModelConfig
from deepkoco.koopman.model_folder import ModelFolderError
from deepkoco.planning.condensed import CondensedProgram
from deepkoco.planning.config import PlannerConfig, PlanningProblem

HORIZON = 15  # as published
PLANNERS = {
    "condensed, daqp": PlannerConfig(HORIZON),
    "condensed, osqp": PlannerConfig(HORIZON, solver="osqp", tolerance=1e-5),
    "sparse, osqp": PlannerConfig(HORIZON, form="sparse", tolerance=1e-5),
}
FRESH = "qpsolvers.solve_problem, osqp, anew each step"


def median_microseconds(decide: Callable[[Array], object], observations: Array) -> float:
    """Median time of one call.

    Args:
        decide: Called with one observation (N,).
        observations: One per call (calls, N).

    Returns:
        Median over the calls after a warm-up of a tenth of them [us].
    """
    times = []
    for observation in observations:
        start = time.perf_counter_ns()
        decide(observation)
        times.append(time.perf_counter_ns() - start)
    return float(np.median(times[len(times) // 10 :])) / 1e3


def fresh_controller(
    model: ExportedModel, config: PlannerConfig, low: Array, high: Array
) -> Callable[[Array], Array]:
    """A controller that builds its quadratic program from scratch at every step.

    Args:
        model: The latent model.
        config: Horizon and weights.
        low: a_min (M,).
        high: a_max (M,).

    Returns:
        Function from observation to action.
    """
    problem = PlanningProblem(
        model.dynamics, low, high, model.action_weight, config.increment_weight, config.horizon
    )
    state = {"action": np.zeros_like(low)}

    def act(observation: Array) -> Array:
        rows, factor = model.linearise(observation, state["action"])
        hessian, gradient = CondensedProgram(problem, "daqp", 1e-6).matrices(rows, factor, state["action"])
        bounds = np.tile(low, config.horizon), np.tile(high, config.horizon)
        program = qpsolvers.Problem(sparse.csc_matrix(hessian), gradient, lb=bounds[0], ub=bounds[1])
        solution = qpsolvers.solve_problem(program, solver="osqp", eps_abs=1e-5, eps_rel=1e-5)
        if solution.x is not None:
            state["action"] = solution.x[: low.size]
        return state["action"]

    return act


def random_model(pairs: int, actions: int, seed: int) -> ExportedModel:
    """A model of a published size; times hardly depend on the weights.

    Args:
        pairs: P.
        actions: M.
        seed: Of the weights.

    Returns:
        The model, for 3 M observation entries.
    """
    torch.manual_seed(seed)
    return export_model(KoopmanModel(3 * actions, actions, ModelConfig(pairs)))


def benchmark(model: ExportedModel, low: Array, high: Array, calls: int) -> dict[str, float]:
    """Time every planner on the same observations.

    Args:
        model: The latent model.
        low: a_min (M,).
        high: a_max (M,).
        calls: Decisions per planner.

    Returns:
        Planner to median time per decision [us].
    """
    observations = np.random.default_rng(0).normal(size=(calls, model.observation_size))
    result = {
        name: median_microseconds(KoopmanPolicy(model, config, low, high).act, observations)
        for name, config in PLANNERS.items()
    }
    result[FRESH] = median_microseconds(
        fresh_controller(model, PlannerConfig(HORIZON), low, high), observations[: max(50, calls // 10)]
    )
    return result


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--model", type=Path, help="folder of an exported model or a run; default: random weights"
    )
    parser.add_argument("--calls", type=int, default=3000, help="decisions per planner")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()
    if arguments.calls < 20:
        parser.error(f"--calls {arguments.calls}: give at least 20")
    if arguments.model is not None:
        try:
            model, _, low, high = load_model(arguments.model)
        except ModelFolderError as error:
            parser.error(f"--model {error}")
        cases = {str(arguments.model): (model, low, high)}
    else:
        sizes = ((10, 1), (30, 2))
        cases = {
            f"P={p}, M={m}": (random_model(p, m, 0), np.full(m, -2.0), np.full(m, 2.0)) for p, m in sizes
        }
    results = {name: benchmark(*case, arguments.calls) for name, case in cases.items()}
    if arguments.json:
        print(json.dumps(results))
        return
    for name, times in results.items():
        print(f"{name}: median time per decision")
        for planner, microseconds in times.items():
            ratio = times[FRESH] / microseconds
            print(f"  {planner:<46} {microseconds:8.1f} us   {ratio:6.1f} x faster than anew")


if __name__ == "__main__":
    main()
