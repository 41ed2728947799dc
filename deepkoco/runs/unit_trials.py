"""`deepkoco trial`: run trained policies on a unit.

Every policy starts from the same states and among the same distractors, so differences are paired.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from gymnasium import spaces
from scipy.stats import bootstrap

from deepkoco.agent import load_policy
from deepkoco.agent.policy import load_model
from deepkoco.envs.distractors import StateDistractors
from deepkoco.envs.distractors.copied import find_copied, own_task
from deepkoco.envs.distractors.options import ITSELF
from deepkoco.envs.film import write_clip
from deepkoco.envs.task_id import find_spec
from deepkoco.envs.unit_env import UnitEnv
from deepkoco.output.new_folder import new_folder
from deepkoco.runs.delayed import load_delayed_policy
from deepkoco.runs.settings import ExperimentError, TrainRunConfig
from deepkoco.runs.train import check_finished, load_run_config
from deepkoco.unit import UnitSpec

FEWEST_EPISODES = 5  # of an interval; resamples of fewer have few different means
Act = Callable[[np.ndarray, Mapping[str, Any]], np.ndarray]
UPRIGHT_ANGLE = 0.5  # mean distance from upright over the last quarter that counts as standing [rad]


@dataclass(frozen=True)
class Trial:
    """One episode of one policy on the unit.

    Attributes:
        policy: Name of the policy, as given by `policy_names`.
        episode: Number of the start state.
        cost: Sum of the step costs.
        upright: Whether it stood at the end.
        overruns: Control steps that came too late.
        frames: Pictures, if they were asked for.
    """

    policy: str
    episode: int
    cost: float
    upright: bool
    overruns: int
    frames: tuple[np.ndarray, ...] = ()


@dataclass(frozen=True)
class Bridging:
    """How a policy bridges delays of a unit: those of observations follow from the numbers of the samples.

    Attributes:
        actuation_delay: Expected time from sending a command until it acts [s].
        increment_weight: R~ of the planner; None takes that of the run.
    """

    actuation_delay: float = 0.0
    increment_weight: float | None = None


def policy_names(runs: Sequence[Path]) -> list[str]:
    """Short names of runs: the fewest last parts of each path that no other run's path ends with.

    Args:
        runs: Folders of training runs.

    Returns:
        One name for each.

    Raises:
        ExperimentError: A folder is given twice.
    """
    resolved = [run.resolve() for run in runs]
    for i, run in enumerate(runs):
        if resolved[i] in resolved[:i]:
            raise ExperimentError(f"{run}: the same run is given twice; name each run once")
    parts = [Path(os.path.abspath(run)).parts for run in runs]
    names = []
    for i, own in enumerate(parts):
        others = parts[:i] + parts[i + 1 :]
        length = 1
        while length < len(own) and any(other[-length:] == own[-length:] for other in others):
            length += 1
        names.append("/".join(own[-length:]).lstrip("/"))
    return names


def check_run(run: Path, unit: UnitSpec) -> None:
    """Check that a trained policy fits the unit before anything moves.

    Args:
        run: Folder of the training run.
        unit: The unit.

    Raises:
        ExperimentError: The run is not finished, or its system, the number of its observation entries or
            its action limits differ from the unit's.
        ModelFolderError: The run holds no readable model.
    """
    config = load_run_config(run)
    check_finished(run)
    if (trained_on := _system_of(config)) not in (None, unit.system):
        raise ExperimentError(f"{run}: trained on task.system {trained_on}, but the unit is a {unit.system}")
    if config.observation != "states":
        raise ExperimentError(f"{run}: trained on observation = {config.observation}; a unit gives states")
    model, _, low, high = load_model(run)
    env = _environment(config, unit, "simulated", film=False)
    entries = env.observation_space.shape or (0,)
    if entries[0] != model.observation_size:
        raise ExperimentError(
            f"{run}: the policy takes {model.observation_size} observation entries, the unit gives "
            f"{entries[0]}; train with the same task.kwargs.action_history and distractors"
        )
    space = env.action_space
    assert isinstance(space, spaces.Box)
    if not (np.allclose(space.low, low) and np.allclose(space.high, high)):
        raise ExperimentError(
            f"{run}: the policy's actions lie in {low.tolist()} to {high.tolist()}, those of the unit in "
            f"{space.low.tolist()} to {space.high.tolist()}; train with another task.kwargs.action_units"
        )


def run_trial(
    run: Path,
    unit: UnitSpec,
    episode: int,
    clock: str = "wall",
    seed: int = 0,
    film: bool = False,
    name: str | None = None,
    bridging: Bridging | None = None,
) -> Trial:
    """Run one noise-free episode of a trained policy on the unit.

    Args:
        run: Folder of the training run.
        unit: The unit.
        episode: Number of the episode, which with `seed` fixes start state and distractors.
        clock: "wall" or "simulated".
        seed: Seed of the set of episodes.
        film: Whether to draw every step.
        name: Of the policy; by default the last part of the folder.
        bridging: How to bridge delays; None ignores them.

    Returns:
        The trial.
    """
    config = load_run_config(run)
    act, restart = _controller(run, config, bridging)
    env = _environment(config, unit, clock, film)
    costs, angles, frames = [], [], []
    try:
        observation, info = env.reset(
            seed=int(np.random.SeedSequence([seed, episode]).generate_state(1)[0] >> 1)
        )
        restart()
        ended = False
        while not ended:
            if film:
                frames.append(env.render())
            observation, reward, _, ended, info = env.step(act(observation, info))
            costs.append(-float(reward))
            angles.append(abs(info["angle_from_upright"]))
        unit_env = env.unwrapped
        assert isinstance(unit_env, UnitEnv)
        overruns = int(unit_env.timing["overruns"])
    finally:
        env.close()
    upright = float(np.mean(angles[-len(angles) // 4 :])) < UPRIGHT_ANGLE
    return Trial(name or run.name, episode, float(np.sum(costs)), upright, overruns, tuple(frames))


def _controller(
    run: Path, config: TrainRunConfig, bridging: Bridging | None
) -> tuple[Act, Callable[[], None]]:
    """What acts on an observation and the `info` that came with it, and what begins an episode."""
    if bridging is None:
        policy = load_policy(run)
        return lambda observation, info: policy.act(observation), policy.reset
    delayed = load_delayed_policy(
        run, config.seed, bridging.actuation_delay, increment_weight=bridging.increment_weight
    )

    def act(observation: np.ndarray, info: Mapping[str, Any]) -> np.ndarray:
        return delayed.act(observation, info["observation_age"], now=info["time"])

    return act, delayed.reset


def _system_of(config: TrainRunConfig) -> str | None:
    """System that a run was trained on; None where its environment does not tell, as one with a unit of its own."""
    if config.task.system != ITSELF:
        return config.task.system
    name = own_task({**find_spec(config.task.id).kwargs, **config.task.kwargs})
    return None if name is None else find_copied(name).system


def _environment(config: TrainRunConfig, unit: UnitSpec, clock: str, film: bool):
    kwargs = config.task.kwargs
    env = UnitEnv(
        unit,
        clock,
        action_units=kwargs.get("action_units", "normalized"),
        action_history=kwargs.get("action_history", 0),
        render_mode="rgb_array" if film else None,
    )
    if config.distractors == "none":
        return env
    # Copies of the unit itself would move it: they are simulated.
    system = unit.system if config.task.system == ITSELF else config.task.system
    options = config.distractor_options
    return StateDistractors(env, config.distractors, options, system, config.seed, "evaluation")


def run_trials(
    runs: Sequence[Path],
    unit: UnitSpec,
    episodes: int,
    clock: str = "wall",
    seed: int = 0,
    parallel: int = 8,
    bridging: Bridging | None = None,
) -> list[Trial]:
    """Run every policy from the same start states, several units at once.

    Args:
        runs: Folders of training runs.
        unit: The unit; each trial gets a process of its own.
        episodes: Episodes for each policy.
        clock: "wall" or "simulated".
        seed: Seed of the set of episodes.
        parallel: Units that run at once.
        bridging: As for `run_trial`.

    Returns:
        The trials, episode by episode.

    Raises:
        ExperimentError: A run is given twice or does not fit the unit; no trial has begun then.
        ModelFolderError: A run holds no readable model.
    """
    names = policy_names(runs)
    for run in runs:
        check_run(run, unit)
        if bridging is not None:
            _controller(run, load_run_config(run), bridging)  # fits what is missing, before units move
    # Alternating the policies spreads whatever the machine does to the timing over both of them.
    jobs = [(*policy, episode) for episode in range(episodes) for policy in zip(runs, names, strict=True)]

    def trial(job: tuple[Path, str, int]) -> Trial:
        run, name, episode = job
        return run_trial(run, unit, episode, clock, seed, name=name, bridging=bridging)

    with ThreadPoolExecutor(parallel if clock == "wall" else 1) as pool:
        return list(pool.map(trial, jobs))


def interval(values: np.ndarray, seed: int = 0) -> tuple[float, float, float]:
    """Mean and its 95 % bootstrap interval; the range of fewer than `FEWEST_EPISODES` values.

    Args:
        values: (n,) values.
        seed: Seed of the bootstrap.

    Returns:
        Mean, lower and upper limit; the limits are NaN for a single value.
    """
    mean = float(np.mean(values))
    if len(values) < 2:
        return mean, math.nan, math.nan
    if np.ptp(values) == 0:
        return mean, mean, mean
    if len(values) < FEWEST_EPISODES:
        return mean, float(values.min()), float(values.max())
    result = bootstrap((values,), np.mean, n_resamples=9999, rng=np.random.default_rng(seed))
    low, high = result.confidence_interval
    return mean, float(low), float(high)


def summarise(trials: Sequence[Trial]) -> dict:
    """Costs per policy and paired differences to the first one, with intervals."""
    names = list(dict.fromkeys(trial.policy for trial in trials))
    ordered = sorted(trials, key=lambda trial: trial.episode)
    costs = {name: np.array([t.cost for t in ordered if t.policy == name]) for name in names}
    summary = {}
    for name, values in costs.items():
        own = [trial for trial in trials if trial.policy == name]
        mean, low, high = interval(values)
        saved, saved_low, saved_high = interval(costs[names[0]] - values)
        summary[name] = {
            "episodes": len(own),
            "mean": mean,
            "low": low,
            "high": high,
            "median": float(np.median(values)),
            "upright": float(np.mean([trial.upright for trial in own])),
            "overruns": sum(trial.overruns for trial in own),
            "saved_against_first": {"mean": saved, "low": saved_low, "high": saved_high},
        }
    return summary


def as_json(summary: dict) -> str:
    """The summary as one line of JSON, with null where an interval is not known."""

    def known(value: object) -> object:
        if isinstance(value, dict):
            return {key: known(entry) for key, entry in value.items()}
        return None if isinstance(value, float) and math.isnan(value) else value

    return json.dumps(known(summary), allow_nan=False)


def write_trials(
    out: Path,
    trials: Sequence[Trial],
    runs: Sequence[Path],
    unit: UnitSpec,
    clock: str,
    seed: int,
    bridging: Bridging | None = None,
) -> None:
    """Write the table `trials.csv` and a film of the first episode of every policy.

    Args:
        out: New folder.
        trials: As given by `run_trials`.
        runs: Folders of the training runs.
        unit: The unit.
        clock: "wall" or "simulated".
        seed: Seed of the set of episodes.
        bridging: As for `run_trial`.
    """
    rows = [{k: v for k, v in vars(t).items() if k != "frames"} for t in trials]
    with new_folder(out) as partial:
        pd.DataFrame(rows).to_csv(partial / "trials.csv", index=False)
        for run, name in zip(runs, policy_names(runs), strict=True):
            film = run_trial(run, unit, 0, clock, seed, film=True, bridging=bridging)
            path = partial / f"{name}.webm"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_clip(path, film.frames, 20.0)
