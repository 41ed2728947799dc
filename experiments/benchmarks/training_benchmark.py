"""What training costs on one core: `python -m experiments.benchmarks.training_benchmark [--json] [--seed-run]`.

Times one gradient step on chunks, in which every step is encoded once for all windows that hold it, and on the same
windows encoded one by one; both in turns in one process. Times are those of the processor, for one thread: what a
quiet machine takes. The time of a seed is predicted from the times of updates,
planning and environments measured in the same call; --seed-run trains a real one.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.buffer import EpisodeBuffer
from deepkoco.agent.collection import box_sizes, collect_episodes
from deepkoco.agent.learner import Learner
from deepkoco.agent.training import Trainer
from deepkoco.koopman.export import export_model
from deepkoco.koopman.losses import ChunkBatch
from deepkoco.runs.agents import register
from deepkoco.runs.environments import make_factory
from deepkoco.runs.hydra_command import CONFIGS
from deepkoco.runs.settings import TrainRunConfig

CASES = {
    "pendulum, states (P = 10, M = 1)": ("task=pendulum",),
    "manipulator, states (P = 30, M = 2)": ("task=manipulator", "agent.model.pairs=30"),
    "pendulum, images (P = 10, M = 1)": ("task=pendulum", "observation=images"),
}
EPISODES = 20
LABELS = {
    "sample": "draw a batch",
    "chunked": "update, chunked",
    "plain": "update, plain",
    "gpu": "the same on GPU",
}


def read_settings(*overrides: str) -> TrainRunConfig:
    """The settings of a training command.

    Args:
        *overrides: As given to `experiments.train`.

    Returns:
        The settings.
    """
    register()
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        config = OmegaConf.to_object(compose("train", list(overrides)))
    assert isinstance(config, TrainRunConfig)
    return config


def separate_windows(batch: ChunkBatch, horizon: int, history: int = 1) -> ChunkBatch:
    """The same windows, each as a chunk of its own.

    Args:
        batch: Chunks of many overlapping windows.
        horizon: T.
        history: d, recordings that an observation is made of.

    Returns:
        One chunk of T + 1 steps per window: the same losses and gradients, every step encoded up to T + 1 times.
    """

    def cut(steps: torch.Tensor, length: int) -> torch.Tensor:
        return steps.unfold(1, length, 1).movedim(-1, 2).flatten(0, 1).contiguous()

    weights = batch.window_weights.flatten()[:, None]
    observations = cut(batch.observations, horizon + history)
    return ChunkBatch(observations, cut(batch.actions, horizon + 1), cut(batch.costs, horizon + 1), weights)


def in_turns(
    calls: dict[str, Callable[[], object]],
    seconds: float,
    least: int = 5,
    clock: Callable[[], int] = time.process_time_ns,
) -> dict[str, np.ndarray]:
    """Time calls one after the other, again and again.

    Args:
        calls: Name to what is timed.
        seconds: For about how long.
        least: Rounds that are made however long they take.
        clock: Reads the time [ns].

    Returns:
        Name to the times without those of a warm-up of three rounds [ms].
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(next(iter(times.values()))) < least + 3:
        for name, call in calls.items():
            start = clock()
            call()
            times[name].append((clock() - start) / 1e6)
    return {name: np.array(values[3:]) for name, values in times.items()}


def clock_of_both() -> int:
    """Time of the clock once the GPU has done what it was given [ns]: processor time says nothing about it."""
    torch.cuda.synchronize()
    return time.perf_counter_ns()


def spread(times: np.ndarray) -> dict[str, float]:
    """Median and the 10th and 90th percentile.

    Args:
        times: (n,).

    Returns:
        The three.
    """
    low, median, high = np.percentile(times, [10, 50, 90])
    return {"median": float(median), "p10": float(low), "p90": float(high)}


def updates_of_a_run(config: TrainRunConfig, episode_steps: int) -> int:
    """Count the updates of a whole training.

    Args:
        config: Settings.
        episode_steps: Steps per episode.

    Returns:
        Updates of all iterations.
    """
    agent = config.agent
    per_episode = (episode_steps - agent.horizon + agent.window_stride - 1) // agent.window_stride
    batch = agent.chunks * (agent.chunk_length - agent.horizon)
    episodes = min(agent.first_episodes, agent.total_episodes)
    updates = agent.first_epochs * max(1, episodes * per_episode // batch)
    while episodes < agent.total_episodes:
        episodes = min(episodes + agent.iteration_episodes, agent.total_episodes)
        epoch = max(1, episodes * per_episode // batch)
        updates += min(agent.iteration_epochs * epoch, agent.iteration_updates)
    return updates


def benchmark(config: TrainRunConfig, seconds: float, gpu: bool = False) -> dict:
    """Measure one task.

    Args:
        config: Settings of its training.
        seconds: For about how long updates are timed.
        gpu: Whether updates are timed on a GPU too; all times are then of the clock.

    Returns:
        Times of an update's parts, of an environment step and a decision, and the predicted time of a seed.
    """
    agent = config.agent
    make = make_factory(config.task, config.distractors, config.observation)
    envs = make(EPISODES, 0)
    observation, low, high = box_sizes(envs)
    torch.manual_seed(0)
    learner = Learner(observation, low.size, agent)
    history = 1 if learner.model.frame_encoder is None else agent.model.frames
    buffer = EpisodeBuffer(history)
    collect_episodes(
        envs, VectorAgent(None, agent.planner, low, high, EPISODES), seed=0
    )  # compiles what is compiled
    walks = {}
    for name, model in (("noise alone", None), ("planned", export_model(learner.averaged))):
        walker = VectorAgent(model, agent.planner, low, high, EPISODES)
        start = time.process_time()
        episodes = collect_episodes(envs, walker, seed=1)
        steps = sum(episode.costs.numel() for episode in episodes)
        walks[name] = 1e3 * (time.process_time() - start) / steps
        buffer.add(episodes)
    envs.close()
    generator = torch.Generator().manual_seed(0)

    def sample() -> ChunkBatch:
        return buffer.sample(agent.chunks, agent.chunk_length, agent.horizon, generator, agent.window_stride)

    batch = sample()
    separate = separate_windows(batch, agent.horizon, history)
    calls = {
        "sample": sample,
        "chunked": lambda: learner.update(batch),
        "plain": lambda: learner.update(separate),
    }
    clock = time.process_time_ns
    if gpu:
        clock = clock_of_both
        on_gpu = Learner(observation, low.size, replace(agent, device="cuda"))
        calls["gpu"] = lambda: on_gpu.update(batch)
    times = in_turns(calls, seconds, clock=clock)
    length = int(np.mean([episode.costs.numel() for episode in episodes]))
    updates = updates_of_a_run(config, length)
    iterations = -(-(agent.total_episodes - agent.first_episodes) // agent.iteration_episodes)
    evaluations = iterations + (agent.keep == "best")  # the last weights are compared with the others first
    evaluated = evaluations * agent.evaluation_episodes + agent.final_evaluation_episodes
    planned = agent.total_episodes - agent.first_episodes + evaluated
    parts = {
        "updates": updates * float(np.median(times["sample"]) + np.median(times["chunked"])) / 1e3,
        "environments": (planned + agent.first_episodes) * length * walks["noise alone"] / 1e3,
        "planning": planned * length * max(0.0, walks["planned"] - walks["noise alone"]) / 1e3,
    }
    return {
        "clock": "wall, after the GPU" if gpu else "processor",
        "update_ms": {name: spread(values) for name, values in times.items()},
        "plain_over_chunked": float(np.median(times["plain"] / times["chunked"])),
        "environment_step_ms": walks["noise alone"],
        "decision_ms": walks["planned"] - walks["noise alone"],
        "updates": updates,
        "seed_seconds": {**parts, "total": sum(parts.values())},
    }


def train_one_seed(config: TrainRunConfig) -> float:
    """Train a real seed.

    Args:
        config: Settings.

    Returns:
        Its time [s].
    """
    with tempfile.TemporaryDirectory() as folder:
        make = make_factory(config.task, config.distractors, config.observation)
        return float(Trainer(make, config.agent, config.seed, Path(folder)).run()["seconds"])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--seconds", type=float, default=10.0, help="for about how long updates are timed, per case"
    )
    parser.add_argument("--gpu", action="store_true", help="time updates on a CUDA device too, by the clock")
    parser.add_argument("--only", choices=("states", "images"), help="leave out the other observations")
    parser.add_argument(
        "--seed-run", action="store_true", help="also train a seed of the first case to its end"
    )
    args = parser.parse_args(arguments)
    if not args.seconds > 0:
        parser.error(f"--seconds {args.seconds}: give a value above 0")
    if args.gpu and not torch.cuda.is_available():
        parser.error(f"--gpu: torch {torch.__version__} finds no CUDA device")
    torch.set_num_threads(1)
    results = {}
    for name, overrides in CASES.items():
        if args.only is None or args.only in name:
            config = read_settings(*overrides)
            results[name] = benchmark(config, args.seconds, args.gpu)
            if args.seed_run and len(results) == 1:
                results[name]["seed_run_seconds"] = train_one_seed(config)
    if args.json:
        json.dump(results, sys.stdout)
        print()
        return
    for name, result in results.items():
        print(name)
        for call, row in result["update_ms"].items():
            label = LABELS[call]
            print(f"  {label:<18} {row['median']:8.2f} ms   ({row['p10']:.2f} to {row['p90']:.2f})")
        print(f"  plain takes {result['plain_over_chunked']:.1f} x as long as chunked")
        print(f"  environment step   {result['environment_step_ms']:8.3f} ms")
        print(f"  decision           {result['decision_ms']:8.3f} ms")
        parts = result["seed_seconds"]
        rest = ", ".join(f"{part} {parts[part]:.0f}" for part in ("updates", "environments", "planning"))
        print(f"  a seed: {parts['total']:.0f} s predicted ({rest}), {result['updates']} updates")
        if "seed_run_seconds" in result:
            print(f"  a seed: {result['seed_run_seconds']:.0f} s measured")


if __name__ == "__main__":
    main()
