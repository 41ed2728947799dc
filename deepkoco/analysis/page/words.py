"""The sentences and numbers at the top of the page, and the facts at its end."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from pathlib import Path

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

import deepkoco
from deepkoco.analysis.measures.comparison import EpisodeCost
from deepkoco.analysis.measures.horizon import HorizonErrors
from deepkoco.analysis.run_folder import TrainedRun
from deepkoco.pages.units import rounded


def lead(run: TrainedRun, pairs: int) -> str:
    """What the model is, for a reader who never saw the project."""
    settings = run.settings
    sees = "pictures" if settings.observation == "images" else f"{run.model.observation_size} numbers"
    distracted = "" if settings.distractors == "none" else f", among distractors ({settings.distractors})"
    return (
        f"A controller for the task {settings.task.name} that sees {sees}{distracted}. It has learned to turn what it "
        f"sees into a latent state of {pairs} pairs of numbers that oscillate, grow or die out independently, and to "
        f"predict the cost of the task from them; every {run.model.time_step:g} s it plans "
        f"{run.planner.horizon} steps ahead on that model. Everything below was measured on new episodes."
    )


def tiles(
    costs: Mapping[str, EpisodeCost],
    errors: HorizonErrors | None,
    horizon: int,
    pruned: tuple[int, int] | None,
) -> list[tuple[str, str]]:
    """The numbers to see first.

    Args:
        costs: Of the comparison.
        errors: Of the model; None where no episode is long enough.
        horizon: H.
        pruned: Least pairs with which control stays good, and all pairs.

    Returns:
        Value and text of each tile.
    """
    found = []
    for name, cost in list(costs.items())[:2]:
        error = "" if np.isnan(cost.standard_error) else f" ± {rounded(2 * cost.standard_error)}"
        text = f"cost of an episode with {name}: mean of {cost.episodes} episodes, ± 2 standard errors"
        found.append((rounded(cost.mean) + error, text))
    if errors is not None:
        share = 100.0 * errors.cost[horizon] / errors.mean_cost[horizon]
        found.append(
            (
                f"{share:.0f} %",
                f"error of the cost predicted {horizon} steps ahead, against predicting the mean",
            )
        )
    if pruned is not None:
        found.append((f"{pruned[0]} of {pruned[1]}", "pairs suffice for control within 10 % of the cost"))
    return found


def facts(run: TrainedRun, episodes: int, seed: int) -> dict[str, str]:
    """Settings and provenance in plain words."""
    settings, planner = run.settings, run.planner
    trained = "not stored" if run.trained_horizon is None else str(run.trained_horizon)
    return {
        "folder": str(run.path),
        "task": f"{settings.task.name} ({settings.task.id})",
        "arguments of the task": str(settings.task.kwargs or "none"),
        "observation": settings.observation,
        "distractors": settings.distractors,
        "seed of the run": str(settings.seed),
        "training horizon T": trained,
        "planning horizon H": str(planner.horizon),
        "weights R, R~": f"{_one_or_each(run.model.action_weight)}, {_one_or_each(planner.increment_weights)}",
        "solver": f"{planner.solver}, {planner.form} form",
        "limits of the action": f"{run.action_low.tolist()} to {run.action_high.tolist()}",
        "episodes of this page": f"{episodes}, noise-free, seed {seed}; distractors from the evaluation split",
        "versions": (
            f"deepkoco {deepkoco.__version__}, numpy {np.__version__}, torch {torch.__version__}, "
            f"gymnasium {gymnasium.__version__}, Python {platform.python_version()}"
        ),
    }


def next_steps(run: TrainedRun) -> list[dict[str, str]]:
    """Commands that go on from here."""
    path = run.path.as_posix()
    steps = []
    if run.is_run:
        evaluate = f"deepkoco evaluate run={path} episodes=200"
        steps.append({"text": "Measure the controller on more episodes.", "command": evaluate})
    use = f'import deepkoco\n\npolicy = deepkoco.load("{path}")\naction = policy.act(observation)'
    steps.append({"text": "Use the controller in a program; this needs no torch.", "command": use})
    export = f"deepkoco export-model {path} --to onnx --out model.onnx"
    steps.append({"text": "Take the model to another program.", "command": export})
    return steps


def pages_around(run: TrainedRun) -> dict[str, Path]:
    """Pages that a run came from: the diagnosis behind the simulation that it was trained in."""
    model = run.settings.task.kwargs.get("model")
    return {"Diagnosis": Path(str(model)).parent / "report.html"} if model else {}


def _one_or_each(weight: float | NDArray[np.float64]) -> str:
    """A weight of all actions, or those of each."""
    return f"{weight:g}" if np.ndim(weight) == 0 else f"({', '.join(f'{w:g}' for w in np.ravel(weight))})"
