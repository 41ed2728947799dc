"""What moves a latent: `python -m experiments.studies.learning.bisimulation_sanity RUNS... --out FOLDER`.

Shows each trained agent the same motions of the task three times: as they are, with other distractors, and with the
motion of another episode among the same distractors. A latent that holds the task alone does not tell the first from
the second, so its distance there, relative to that from the third, is 0; where distractors count as much as the task
does it is 1. Writes ``latent_distances.csv``, ``latent_distances.png`` and ``PROVENANCE.md``.

SAC without an encoder sees the observation itself, which is what the others are to improve on.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from baselines.model_files import read_networks
from baselines.policy import Observer
from baselines.registry import BASELINES
from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.agent.policy import load_model
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.envs.distractors.copied import resolve_copied
from deepkoco.envs.distractors.registry import PIXEL, make_distractors
from deepkoco.envs.distractors.state_wrapper import Mixer
from deepkoco.envs.frames import FrameMaker, PaintedFrames, find_painter
from deepkoco.envs.pixels import FRAME_SIZE
from deepkoco.output.new_folder import new_folder
from deepkoco.output.whole_file import whole_file
from deepkoco.runs.environments import make_factory
from deepkoco.runs.hydra_command import BAD_INPUT
from deepkoco.runs.settings import ExperimentError, TrainRunConfig
from deepkoco.runs.train import check_finished, load_run_config
from experiments.plumbing.provenance import as_markdown
from experiments.studies.learning.comparison.style import STYLE, method_rank, method_style

INDEX = 2_000  # of the start states: none that an agent was trained or evaluated from
FIRST_DISTRACTORS, OTHER_DISTRACTORS = 1, 2
Observations = list[NDArray[Any]]
"""Of every step, those of all episodes (B, ...)."""
Encoder = Callable[[Observations], NDArray[np.float64]]
"""From observations to latents (T, B, Z)."""


def motions(run: TrainRunConfig, episodes: int, steps: int) -> NDArray[np.float64]:
    """States of the task under actions drawn uniformly and held for five steps.

    Args:
        run: Its task.
        episodes: B.
        steps: T.

    Returns:
        What the task alone shows (T, B, N), from start states that are the same for all runs of a task.
    """
    envs = make_factory(run.task, "none")(episodes, 0)
    seed = derive_seed(0, Purpose.FINAL_EVALUATION, INDEX)
    random = np.random.default_rng(seed)
    low, high = envs.single_action_space.low, envs.single_action_space.high  # type: ignore[attr-defined]
    observation, _ = envs.reset(seed=seed)
    shown, action = [np.array(observation)], None
    while len(shown) < steps:
        if action is None or len(shown) % 5 == 0:
            action = random.uniform(low, high, (episodes, low.size)).astype(low.dtype)
        observation, _, terminated, truncated, _ = envs.step(action)
        if (terminated | truncated).any():
            break
        shown.append(np.array(observation))
    envs.close()
    return np.stack(shown).astype(np.float64)


def show_states(run: TrainRunConfig, states: NDArray[np.float64], seed: int) -> Observations:
    """The task's motion (T, B, N) among distractors of states, as the agent of a run sees it."""
    envs = make_factory(run.task, "none")(1, run.seed)
    batch, acted = states.shape[1], envs.single_action_space
    assert isinstance(acted, spaces.Box)
    mixer = Mixer(
        envs, run.distractors, batch, run.distractor_options, run.task.system, run.seed, "evaluation"
    )
    envs.close()
    mixer.reset(seed)
    middle = np.broadcast_to(0.5 * (acted.low + acted.high), (batch, *acted.shape))
    return _step_by_step(states, mixer.mix, lambda: mixer.advance(middle))


def show_images(run: TrainRunConfig, states: NDArray[np.float64], seed: int) -> Observations:
    """The task's motion (T, B, N) as frames with distractors, as the agent of a run sees it."""
    envs = make_factory(run.task, "none")(1, run.seed)
    painter, copied = find_painter(envs), resolve_copied(run.task.system, envs)
    envs.close()
    if painter is None:
        raise ExperimentError(
            f"task {run.task.name} is rendered: a motion of it cannot be shown again; choose a task that draws itself"
        )
    count, options = states.shape[1], run.distractor_options
    layers = make_distractors(PIXEL, run.distractors, count, options, copied, "evaluation", FRAME_SIZE)
    maker = FrameMaker(PaintedFrames(painter), tuple(layers.values()), count, FRAME_SIZE)
    maker.reset(seed)
    return _step_by_step(states, maker.draw, maker.advance)


def _step_by_step(
    states: NDArray[np.float64], show: Callable[[NDArray[Any]], NDArray[Any]], advance: Callable[[], None]
) -> Observations:
    shown = []
    for state in states:
        shown.append(np.array(show(state.astype(np.float32))))
        advance()
    return shown


SHOW = {"states": show_states, "images": show_images}


def koopman_encoder(folder: Path) -> Encoder:
    """phi(o, a) of a DeepKoCo run, at action 0."""
    model, _, low, _ = load_model(folder)

    def encode(observations: Observations) -> NDArray[np.float64]:
        history = model.make_history()
        latents = []
        for shown in observations:
            seen = shown.astype(np.float64) if history is None else history.push(shown)
            rows, _ = model.linearise(seen, np.zeros((len(seen), low.size)))
            latents.append(rows[:, 0])
        return np.stack(latents)

    return encode


def baseline_encoder(folder: Path) -> Encoder:
    """The encoder that the critics of a baseline see through."""
    stored = read_networks(folder)

    @torch.no_grad()
    def encode(observations: Observations) -> NDArray[np.float64]:
        observer = Observer(stored.shape, stored.config.frames)
        latents = [stored.critic.encode(observer.observe(shown)) for shown in observations]
        return torch.stack(latents).double().numpy()

    return encode


ENCODERS: dict[str, Callable[[Path], Encoder]] = {
    "deepkoco": koopman_encoder,
    **dict.fromkeys(BASELINES, baseline_encoder),
}


def measure(folder: Path, episodes: int, steps: int) -> dict[str, Any]:
    """How far a run's latents move with the distractors and with the task.

    Args:
        folder: A finished run that was trained with distractors.
        episodes: B, at least 2.
        steps: T.

    Returns:
        A row of the table. Distances are mean absolute differences of entries; `ratio` is that of the distractors
        over that of the task, `observation_ratio` the same of what the agent sees.

    Raises:
        ExperimentError: The run is not finished, saw no distractors, or its agent or task is not known here.
    """
    run = load_run_config(folder)
    check_finished(folder)
    if run.distractors == "none":
        raise ExperimentError(
            f"{folder}: trained without distractors, nothing to compare; give runs with some"
        )
    if run.agent.name not in ENCODERS:
        raise ExperimentError(f"{folder}: agent {run.agent.name} is none of {', '.join(ENCODERS)}")
    states = motions(run, episodes, steps)
    as_is, others = showings(run, states)
    moved, seen = (
        distances(ENCODERS[run.agent.name](folder), as_is, others),
        distances(np.stack, as_is, others),
    )
    return {
        "agent": run.agent.name,
        "task": run.task.name,
        "observation": run.observation,
        "distractors": run.distractors,
        "seed": run.seed,
        "distance_distractors": moved["distractors"],
        "distance_task": moved["task"],
        "ratio": moved["distractors"] / moved["task"] if moved["task"] else float("nan"),
        "observation_ratio": seen["distractors"] / seen["task"],
        "run": folder.as_posix(),
    }


def showings(
    run: TrainRunConfig, states: NDArray[np.float64]
) -> tuple[Observations, dict[str, Observations]]:
    """The task's motion as it is, and with other distractors or another motion of the task.

    Args:
        run: Says what an agent sees.
        states: Of the task (T, B, N).

    Returns:
        What is seen as it is, and by name what is seen where one thing changed.
    """
    show = SHOW[run.observation]
    return show(run, states, FIRST_DISTRACTORS), {
        "distractors": show(run, states, OTHER_DISTRACTORS),
        "task": show(run, np.roll(states, 1, axis=1), FIRST_DISTRACTORS),
    }


def distances(encode: Encoder, as_is: Observations, others: dict[str, Observations]) -> dict[str, float]:
    """Mean absolute differences of latents from those of what is seen as it is.

    Args:
        encode: Gives the latents.
        as_is: What they are compared with.
        others: By name.

    Returns:
        By name.
    """
    latents = encode(as_is).astype(np.float64)
    return {name: float(np.abs(encode(shown) - latents).mean()) for name, shown in others.items()}


def draw(table: pd.DataFrame, path: Path) -> None:
    """One panel per task, kind of observation and distractors; a dot per seed, mean and 95 % interval.

    Args:
        table: Rows of `measure`.
        path: Of the PNG.
    """
    panels: list[Any] = list(table.groupby(["task", "observation", "distractors"]))
    with plt.style.context(STYLE):
        figure, axes = plt.subplots(1, len(panels), figsize=(4.5 * len(panels), 3.6), squeeze=False)
        for axis, ((task, observation, distractors), rows) in zip(axes[0], panels, strict=True):
            agents = sorted(set(rows["agent"]), key=method_rank)
            for place, agent in enumerate(agents):
                style = method_style(agent)
                ratios = rows.loc[rows["agent"] == agent, "ratio"].to_numpy()
                mean, low, high = mean_with_band(ratios)
                axis.bar(place, mean, 0.6, color=style.colour, alpha=0.4)
                axis.plot([place] * ratios.size, ratios, "o", color=style.colour, markersize=4)
                if ratios.size > 1:
                    axis.plot([place, place], [max(low, 0.0), high], color=style.colour)
            axis.axhline(
                rows["observation_ratio"].mean(), color="#555555", linestyle="--", label="observation"
            )
            axis.set_xticks(range(len(agents)), [method_style(agent).label for agent in agents])
            axis.set(
                title=f"{task}, {observation}, {distractors}", ylabel="latent distance, distractors / task"
            )
            axis.legend()
        with whole_file(path) as partial:
            figure.savefig(partial, format="png")
        plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        description="Compare what distractors and what the task move in a latent."
    )
    parser.add_argument("runs", type=Path, nargs="+", help="finished runs, trained with distractors")
    parser.add_argument("--out", type=Path, required=True, help="new folder")
    parser.add_argument("--episodes", type=int, default=32, help="episodes that are shown (default 32)")
    parser.add_argument("--steps", type=int, default=50, help="steps of each (default 50)")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    try:
        if args.out.exists():
            raise ExperimentError(f"{args.out}: exists already; choose another --out")
        if args.episodes < 2 or args.steps < 1:
            raise ExperimentError(f"--episodes {args.episodes} --steps {args.steps}: give at least 2 and 1")
        rows = []
        for folder in args.runs:
            rows.append(measure(folder, args.episodes, args.steps))
            print(
                f"{folder}: {rows[-1]['ratio']:.3f} ({rows[-1]['observation_ratio']:.3f} in what it sees)",
                flush=True,
            )
    except (*BAD_INPUT, gymnasium.error.Error) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    table = pd.DataFrame(rows)
    with new_folder(args.out) as partial:
        table.to_csv(partial / "latent_distances.csv", index=False, float_format="%.6g")
        draw(table, partial / "latent_distances.png")
        (partial / "PROVENANCE.md").write_text(as_markdown() + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
