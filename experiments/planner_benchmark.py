"""Time per decision on one core: `python -m experiments.planner_benchmark [--json] [--model FOLDER] [--episodes N]`.

Compares the public `act()` of every planner and solver with building and solving the same program anew by
`qpsolvers.solve_problem` at every step, in the same process and on the same observations. With `--episodes`
it also compares what each planner costs in closed loop from the same start states.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import qpsolvers
import torch
from scipy import sparse

from deepkoco.agent.policy import KoopmanPolicy, load_model
from deepkoco.koopman.export import export_model
from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.koopman.files.model_folder import ModelFolderError
from deepkoco.koopman.model.model import KoopmanModel, ModelConfig
from deepkoco.planning.condensed import CondensedProgram
from deepkoco.planning.config import PlannerConfig, PlanningProblem
from deepkoco.planning.solvers import solver_names
from deepkoco.runs.settings import ExperimentError
from experiments.planner_costs import closed_loop_costs, observed_sequence

HORIZON = 15  # as published
FRESH = "qpsolvers.solve_problem, osqp, anew each step"
NETWORK = "network alone: s, B and C"
CEM = "cem, 500 samples x 5, C per sample"
CEM_FROZEN = "cem, 500 samples x 5, frozen B and C"
FASTEST = "condensed, daqp"
ROUNDS = 10
SHARE = {FRESH: 0.2, "sparse": 0.2, CEM: 0.02, CEM_FROZEN: 0.05}
"""Share of the calls that slow planners make."""


@dataclass
class Timing:
    """Time of one decision [us].

    Attributes:
        median: Over all calls.
        p95: 95th percentile.
        calls: How many.
    """

    median: float
    p95: float
    calls: int


def planners(model: ExportedModel, horizon: int) -> dict[str, PlannerConfig]:
    """Every planner that this model and installation can run.

    Args:
        model: The latent model.
        horizon: H.

    Returns:
        Name to settings.
    """
    configs = {
        f"{form}, {solver}": PlannerConfig(horizon, form=form, solver=solver)
        for form in ("condensed", "sparse")
        for solver in solver_names(form)
    }
    if model.decoder:
        for linearisation in ("along_plan", "tangent"):
            configs[f"{linearisation}, daqp"] = PlannerConfig(horizon, linearisation=linearisation)
    configs["cost_along_plan, daqp"] = PlannerConfig(horizon, linearisation="cost_along_plan")
    configs[CEM_FROZEN] = PlannerConfig(horizon, method="cem")
    configs[CEM] = PlannerConfig(horizon, method="cem", linearisation="cost_along_plan")
    return configs


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
        model.dynamics,
        low,
        high,
        model.action_weight,
        config.increment_weight,
        config.horizon,
        model.cost_rank,
    )
    state = {"action": np.zeros_like(low)}

    def act(observation: Array) -> Array:
        rows, factor = model.linearise(observation, state["action"])
        hessian, gradient = CondensedProgram(problem, "auto", 1e-6).matrices(rows, factor, state["action"])
        bounds = np.tile(low, config.horizon), np.tile(high, config.horizon)
        program = qpsolvers.Problem(sparse.csc_matrix(hessian), gradient, lb=bounds[0], ub=bounds[1])
        solution = qpsolvers.solve_problem(program, solver="osqp", eps_abs=1e-6, eps_rel=1e-6)
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


def wandering_observations(model: ExportedModel, calls: int) -> Array:
    """Observations that change from step to step as those of a robot do, so that warm starts mean something.

    Args:
        model: Gives N.
        calls: How many.

    Returns:
        A stationary autoregressive sequence (calls, N) with unit variance.
    """
    rng = np.random.default_rng(0)
    steps = rng.normal(size=(calls, model.observation_size))
    for k in range(1, calls):
        steps[k] = 0.95 * steps[k - 1] + (1 - 0.95**2) ** 0.5 * steps[k]
    return steps


def benchmark(
    model: ExportedModel, low: Array, high: Array, observations: Array, horizon: int = HORIZON
) -> dict[str, Timing]:
    """Time every planner on the same observations, in turns, so that a busy moment hits all of them.

    Args:
        model: The latent model.
        low: a_min (M,).
        high: a_max (M,).
        observations: One per decision, in order (calls, N).
        horizon: H.

    Returns:
        Planner to time per decision.
    """
    action = np.zeros_like(low)
    deciders: dict[str, Callable[[Array], object]] = {
        NETWORK: lambda observation: model.linearise(observation, action),
        FRESH: fresh_controller(model, PlannerConfig(horizon), low, high),
    }
    for name, config in planners(model, horizon).items():
        deciders[name] = KoopmanPolicy(model, config, low, high).act
    times: dict[str, list[int]] = {name: [] for name in deciders}
    for block in np.array_split(observations, ROUNDS):
        for name, decide in deciders.items():
            share = SHARE.get(name, SHARE.get(name.split(",")[0], 1.0))
            for i, observation in enumerate(block[: max(2, round(share * len(block)))]):
                start = time.perf_counter_ns()
                decide(observation)
                if i:  # the first call of a turn finds the caches full of the planner before
                    times[name].append(time.perf_counter_ns() - start)
    return {
        name: Timing(float(np.median(t)) / 1e3, float(np.percentile(t, 95)) / 1e3, len(t))
        for name, t in times.items()
    }


def case(
    model: ExportedModel, low: Array, high: Array, observations: Array, run: Path | None, episodes: int
) -> dict[str, Any]:
    """All figures of one model.

    Args:
        model: The latent model.
        low: a_min (M,).
        high: a_max (M,).
        observations: (calls, N).
        run: Folder of the run, for closed-loop costs.
        episodes: How many for those; 0 for none.

    Returns:
        Times by planner, ratios, and costs by planner.
    """
    times = benchmark(model, low, high, observations)
    result: dict[str, Any] = {
        "planners": {
            name: {"median_us": t.median, "p95_us": t.p95, "calls": t.calls} for name, t in times.items()
        },
        "osqp_against_fastest": times["condensed, osqp"].median / times[FASTEST].median,
        "cem_against_fastest": times[CEM].median / times[FASTEST].median,
        "frozen_cem_against_fastest": times[CEM_FROZEN].median / times[FASTEST].median,
        "fresh_against_fastest": times[FRESH].median / times[FASTEST].median,
    }
    if run is not None and episodes:
        result["costs"] = closed_loop_costs(run, planners(model, HORIZON), FASTEST, episodes)
    return result


def show(name: str, result: dict[str, Any]) -> None:
    """Print one table.

    Args:
        name: Of the case.
        result: See `case`.
    """
    fresh = result["planners"][FRESH]["median_us"]
    print(f"{name}: time per decision, H = {HORIZON}\n  {'':<46}   median      95 %    x faster than anew")
    for planner, t in result["planners"].items():
        print(f"  {planner:<46} {t['median_us']:9.1f} {t['p95_us']:9.1f} us {fresh / t['median_us']:9.2f}")
    print(
        f"  osqp takes {result['osqp_against_fastest']:.2f} x, cem {result['cem_against_fastest']:.0f} x "
        f"({result['frozen_cem_against_fastest']:.0f} x with frozen B and C) "
        f"the time of {FASTEST}"
    )
    for planner, cost in result.get("costs", {}).items():
        print(
            f"  {planner:<46} cost {cost['mean']:7.1f} +- {cost['standard_error']:.1f}, "
            f"against {FASTEST} {cost['difference']:+.2f} +- {cost['difference_standard_error']:.2f} "
            f"({cost['episodes']} episodes, {cost['failures']} failures)"
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--model", type=Path, help="folder of an exported model or a run; default: random weights"
    )
    parser.add_argument("--calls", type=int, default=3000, help="decisions per planner")
    parser.add_argument(
        "--episodes", type=int, default=0, help="closed-loop episodes per planner; --model must be a run"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()
    if arguments.calls < 20:
        parser.error(f"--calls {arguments.calls}: give at least 20")
    if arguments.episodes < 0 or (arguments.episodes and arguments.model is None):
        parser.error(f"--episodes {arguments.episodes}: give 0 or more, and the run as --model")
    torch.set_num_threads(1)
    results: dict[str, Any] = {}
    try:
        if arguments.model is None:
            for pairs, actions in ((10, 1), (30, 2)):
                model, limit = random_model(pairs, actions, 0), np.full(actions, 2.0)
                observations = wandering_observations(model, arguments.calls)
                results[f"P={pairs}, M={actions}"] = case(model, -limit, limit, observations, None, 0)
        else:
            model, _, low, high = load_model(arguments.model)
            if not isinstance(model, ExportedModel) or model.frame_encoder is not None:
                parser.error(f"--model {arguments.model}: give a trained model on states")
            run = arguments.model if (arguments.model / "config.yaml").is_file() else None
            if run is None and arguments.episodes:
                parser.error(f"--model {arguments.model}: --episodes needs the folder of a run")
            if run is None:
                observations = wandering_observations(model, arguments.calls)
            else:
                observations = observed_sequence(run, PlannerConfig(HORIZON), arguments.calls)
            results[str(arguments.model)] = case(model, low, high, observations, run, arguments.episodes)
    except (ModelFolderError, ExperimentError) as error:
        parser.error(f"--model {error}")
    if arguments.json:
        print(json.dumps(results))
        return
    for name, result in results.items():
        show(name, result)


if __name__ == "__main__":
    main()
