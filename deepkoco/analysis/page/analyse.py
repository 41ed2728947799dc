"""All analyses of a trained run, one stage after the other, put together on one page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import yaml
from gymnasium.vector import VectorEnv

from deepkoco.agent.buffer import Episode
from deepkoco.agent.collection import episode_costs
from deepkoco.agent.eigenvalue_history import EIGENVALUE_FILE
from deepkoco.agent.references.files import read_comparison
from deepkoco.agent.references.picture import draw_references
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.analysis.measures.collect import (
    as_steps,
    closed_loop_costs,
    make_envs,
    run_episodes,
    run_exploring,
)
from deepkoco.analysis.measures.comparison import EpisodeCost, draw_comparison, episode_cost, fit_comparison
from deepkoco.analysis.measures.contribution import Contribution, cost_contribution, draw_contribution
from deepkoco.analysis.measures.eigenfunctions import draw_eigenfunctions
from deepkoco.analysis.measures.eigenvalues import draw_eigenvalues, draw_history
from deepkoco.analysis.measures.horizon import HorizonErrors, draw_horizon, horizon_errors
from deepkoco.analysis.measures.input_maps import draw_input_maps
from deepkoco.analysis.measures.inputs import describe_inputs
from deepkoco.analysis.measures.learning import draw_learning
from deepkoco.analysis.measures.linearity import draw_linearity
from deepkoco.analysis.measures.modes import Modes, find_modes
from deepkoco.analysis.measures.plans import draw_planned_costs, planned_costs
from deepkoco.analysis.measures.pruning import control_pruned, draw_pruning, prune
from deepkoco.analysis.measures.replays import ReplayError
from deepkoco.analysis.measures.rollout import Rollout, roll_out
from deepkoco.analysis.measures.saliency import draw_saliency
from deepkoco.analysis.measures.sensitivity import draw_sensitivity, input_sensitivity
from deepkoco.analysis.measures.steps import Steps
from deepkoco.analysis.measures.view import choose_axes, choose_view
from deepkoco.analysis.measures.wrapped_model import WrappedModel
from deepkoco.analysis.page.film_run import film_run
from deepkoco.analysis.page.page import Page
from deepkoco.analysis.page.plan_film import PlanFilm
from deepkoco.analysis.page.words import facts, lead, next_steps, pages_around, tiles
from deepkoco.analysis.run_folder import TrainedRun
from deepkoco.koopman.exported import ExportedModel
from deepkoco.koopman.latent_model import LatentModel
from deepkoco.output.picture import Picture, house_style

Report = Callable[[str, int, int], None]
"""Called with (what is done next, stages done, stages in all)."""
STAGES = (
    "running episodes",
    "running episodes with exploration noise",
    "eigenvalues and contributions",
    "pruning",
    "comparing with EDMDc",
    "drawing maps",
    "planning again",
    "filming",
    "writing",
)


@dataclass(frozen=True)
class AnalysisOptions:
    """How much is computed.

    Attributes:
        episodes: New noise-free episodes that everything is measured on.
        exploring_episodes: New episodes with exploration noise that EDMDc is fitted to.
        windows: Most windows for errors against the horizon.
        prunings: Most numbers of pairs with which the loop is closed.
        film_plans: Most plans drawn in the film.
        axes: Two inputs (counted from 0) for maps of tasks without a plane; None takes those that matter most.
        seed: Which start states; none of training or evaluation.
    """

    episodes: int = 24
    exploring_episodes: int = 160
    windows: int = 1500
    prunings: int = 8
    film_plans: int = 100
    axes: tuple[int, int] | None = None
    seed: int = 0


@dataclass
class _Analysis:
    """What the stages share."""

    run: TrainedRun
    options: AnalysisOptions
    report: Report
    generator: np.random.Generator
    notes: list[str] = field(default_factory=list)
    pictures: dict[str, Picture] = field(default_factory=dict)
    done: int = 0

    def next_stage(self) -> None:
        self.report(STAGES[self.done], self.done, len(STAGES))
        self.done += 1

    def add(self, *pictures: Picture | None) -> None:
        self.pictures |= {picture.name: picture for picture in pictures if picture is not None}

    def seed(self, purpose: int) -> int:
        # Far from the indices of training's own evaluation and of `deepkoco evaluate`.
        index = 2**20 + 16 * self.options.seed + purpose
        return derive_seed(self.run.settings.seed, Purpose.FINAL_EVALUATION, index)


ORDER = (
    "references", "comparison", "planned_cost", "error_by_horizon", "eigenvalues", "eigenvalue_history", "contribution",
    "pruning", "sensitivity", "saliency", "eigenfunctions", "input_maps", "linearity", "learning",
)  # fmt: skip


def analyse(
    run: TrainedRun, options: AnalysisOptions, reference: Mapping[str, EpisodeCost], report: Report
) -> Page:
    """Compute everything that the page shows.

    Args:
        run: The run or model.
        options: How much is computed.
        reference: Further costs to show in the comparison.
        report: For a progress display.

    Returns:
        The page.

    Raises:
        TaskError: The stored task cannot be made here.
        ModelMismatchError: The model does not fit the task.
    """
    with house_style():
        return _analyse(_Analysis(run, options, report, np.random.default_rng(options.seed)), reference)


def _analyse(work: _Analysis, reference: Mapping[str, EpisodeCost]) -> Page:
    run, options = work.run, work.options
    model, horizon = run.model, run.planner.horizon
    work.next_stage()
    envs = make_envs(run, options.episodes)
    episodes = run_episodes(envs, run, model, work.seed(0))
    steps, costs = as_steps(run, episodes), episode_costs(episodes)
    work.next_stage()
    exploring = as_steps(run, run_exploring(run, options.exploring_episodes, work.seed(1)))

    work.next_stage()
    modes = find_modes(model.dynamics, model.time_step)
    contribution = cost_contribution(model, modes, steps)
    first = steps.windows(horizon, options.windows, work.generator)
    rollout = roll_out(model, steps, first, horizon)
    work.add(draw_eigenvalues(modes, contribution), draw_contribution(contribution, modes))
    if run.is_run and (measured := read_comparison(run.path)) is not None:
        work.add(draw_references(measured))
    work.add(draw_history(run.path / EIGENVALUE_FILE), draw_learning(run.path / "metrics.csv"))
    if run.is_run and "eigenvalue_history" not in work.pictures:
        work.notes.append(f"The history of the eigenvalues: this run has no {EIGENVALUE_FILE}.")

    work.next_stage()
    control = closed_loop_costs(envs, run, work.seed(0))
    work.add(_pruning(work, modes, rollout, control, costs.size))

    work.next_stage()
    linear = fit_comparison(exploring, model.time_step, model.action_weight, work.generator)
    compared = {"DeepKoCo": episode_cost(costs)}
    for factor, name in ((1, "EDMDc + MPC"), (3, "EDMDc + MPC, horizon x 3")):
        farther = replace(run, planner=replace(run.planner, horizon=factor * horizon))
        control = closed_loop_costs(envs, farther, work.seed(0))
        compared[name] = episode_cost(control(WrappedModel(linear, model)))
    compared |= reference
    fitted = f"fitted here to {len(exploring.lengths)} new episodes with exploration noise"
    work.add(draw_comparison(compared, fitted))
    errors = _horizon(work, linear, steps)

    work.next_stage()
    _maps(work, envs, steps, modes, contribution, rollout, first, episodes)
    envs.close()

    work.next_stage()
    planned = planned_costs(model, run.planner, run.action_low, run.action_high, steps)
    if planned.planned.size:
        work.add(draw_planned_costs(planned, horizon, model.time_step))

    work.next_stage()
    film = _film(work)
    work.next_stage()
    return Page(
        title=f"{run.path.resolve().name}: what the model has learned",
        lead=lead(run, len(modes.eigenvalues)),
        tiles=tiles(compared, errors.get("DeepKoCo"), horizon, pruned_well(work.pictures["pruning"])),
        pictures=[work.pictures[name] for name in ORDER if name in work.pictures],
        film=film,
        facts=facts(run, options.episodes, work.seed(0)),
        settings=yaml.safe_dump(run.details, sort_keys=False),
        notes=work.notes,
        steps=next_steps(run),
        pages=pages_around(run),
    )


def pruned_well(picture: Picture, tolerance: float = 1.1) -> tuple[int, int] | None:
    """Least pairs down to which an episode costs at most a tenth more, and all pairs; None without a closed loop.

    Where fewer pairs happen to do well again, this does not count.
    """
    done = picture.table.dropna(subset="closed_loop_cost")
    if done.empty:
        return None
    kept, costs = done["pairs_kept"].to_numpy(), done["closed_loop_cost"].to_numpy()
    good = np.logical_and.accumulate(costs <= tolerance * costs[0])
    return int(kept[good].min()), int(kept.max())


def _pruning(
    work: _Analysis,
    modes: Modes,
    rollout: Rollout,
    control: Callable[[LatentModel], np.ndarray],
    episodes: int,
) -> Picture:
    model = work.run.model
    pruning = prune(modes, rollout, model.action_weight)
    pairs = pruning.removed.size
    counts = sorted(
        {round(k) for k in np.linspace(pairs, 1, min(pairs, work.options.prunings))}, reverse=True
    )
    pruning = control_pruned(pruning, model, modes, counts, control)
    return draw_pruning(pruning, work.run.planner.horizon, episodes)


def _horizon(work: _Analysis, linear: LatentModel, steps: Steps) -> dict[str, HorizonErrors]:
    run, planned = work.run, work.run.planner.horizon
    longest = 2 * max(planned, run.trained_horizon or 0)
    first = steps.windows(longest, work.options.windows, work.generator)
    if not first.size:
        work.notes.append(f"Errors against the horizon: no episode has {longest + 1} steps.")
        return {}
    models = {"DeepKoCo": run.model, "EDMDc": linear}
    errors = {name: horizon_errors(roll_out(model, steps, first, longest)) for name, model in models.items()}
    work.add(draw_horizon(errors, run.trained_horizon, planned, run.model.time_step, first.size))
    return errors


def _maps(
    work: _Analysis,
    envs: VectorEnv,
    steps: Steps,
    modes: Modes,
    contribution: Contribution,
    rollout: Rollout,
    first: np.ndarray,
    episodes: list[Episode],
) -> None:
    run, model = work.run, work.run.model
    if isinstance(model, ExportedModel) and model.frame_encoder is not None:
        spread = np.sqrt(np.square(rollout.encoded - rollout.encoded.mean((0, 1))).sum(-1).mean())
        frames, actions = episodes[0].observations.numpy(), episodes[0].actions.numpy()
        work.add(draw_saliency(model, frames, actions.astype(np.float64), float(spread)))
        work.notes.append(
            "Eigenfunctions, B and C over a plane and the sensitivity by input: the model sees frames, of which "
            "no plane can be made up; the picture of where it looks stands for them."
        )
        return
    chosen = steps.sample(600, work.generator)
    observations, actions = steps.observations[chosen], steps.actions[chosen]
    sensitivity = input_sensitivity(model, observations, actions, run.planner.horizon)
    inputs = describe_inputs(envs, model.observation_size)
    axes = work.options.axes or choose_axes(sensitivity.cost, inputs.is_task)
    view = choose_view(envs, inputs, axes, observations[0])
    points = view.points(steps, work.generator)
    still = np.clip(np.zeros_like(run.action_low), run.action_low, run.action_high)
    work.add(
        draw_sensitivity(sensitivity, inputs),
        draw_eigenfunctions(model, modes, contribution, points, run.action_low, run.action_high),
        draw_input_maps(model, points, still),
        draw_linearity(rollout, *view.coordinates(steps.observations[first]), view.labels),
    )


def _film(work: _Analysis) -> tuple[PlanFilm, str] | None:
    try:
        return film_run(work.run, work.seed(3), work.options.film_plans)
    except ReplayError as error:
        work.notes.append(f"The film of the plan: {error}.")
        return None
