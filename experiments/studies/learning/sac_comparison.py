"""Our SAC beside that of stable-baselines3.

    python -m experiments.studies.learning.sac_comparison --seeds 0 1 2 --steps 10000

Both train on Pendulum-v1 with the same network, hyper-parameters and steps, one seed of one after the same seed of
the other; both are evaluated on the same start states. Updates are timed at the end of each seed in blocks that take
turns, so whatever else the machine does falls on both. Needs the bench extra.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import VectorEnv

from baselines.config import BaselineConfigError, SacConfig
from baselines.training import BaselineTrainer
from deepkoco.agent.collection import collect_episodes, episode_costs
from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.runs.settings import ExperimentError
from experiments.plumbing.provenance import provenance

TASK = "Pendulum-v1"
EPISODE_STEPS = 200
OURS, THEIRS = "ours", "stable_baselines3"
RATE, BATCH, HIDDEN, TAU, FIRST = 1e-3, 256, 256, 0.005, 200
BLOCKS, BLOCK_UPDATES = 20, 20


@dataclass(frozen=True)
class SeedResult:
    """What one training gave.

    Attributes:
        cost: Mean noise-free cost of an episode after training.
        training_cost: Mean cost of all training episodes.
        cpu_ms: CPU time of an update with its draw from the replay, median of the blocks [ms].
        wall_ms: Wall-clock time of the same [ms].
    """

    cost: float
    training_cost: float
    cpu_ms: float
    wall_ms: float


def make_pendulum(count: int, seed: int) -> VectorEnv:
    """Pendulum-v1 for both."""
    return gymnasium.make_vec(TASK, count, vectorization_mode="sync")


def our_config(steps: int, episodes: int) -> SacConfig:
    """Settings of ours that are those of stable-baselines3's defaults, with a learning rate of 1e-3.

    Args:
        steps: Of the training.
        episodes: Of the evaluation.
    """
    return SacConfig(
        total_episodes=steps // EPISODE_STEPS, random_steps=FIRST, batch=BATCH, hidden=HIDDEN, learning_rate=RATE,
        temperature=1.0, temperature_learning_rate=RATE, temperature_beta=0.9, target_rate=TAU, actor_every=1,
        target_every=1, evaluation_every=1, evaluation_episodes=0, final_evaluation_episodes=episodes,
        checkpoint_episodes=steps,
    )  # fmt: skip


class TheirPolicy:
    """The mean action of a model of stable-baselines3."""

    def __init__(self, model: Any) -> None:
        self._model = model

    def reset(self) -> None:
        """Nothing is kept."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions (B, M) for observations (B, N)."""
        return self._model.predict(observations.astype(np.float32), deterministic=True)[0]


def compare_seed(seed: int, steps: int, episodes: int) -> dict[str, SeedResult]:
    """Train both with one seed.

    Args:
        seed: Of both.
        steps: Environment steps.
        episodes: Of the evaluation.

    Returns:
        By name.
    """
    sac = _stable_baselines3()
    with tempfile.TemporaryDirectory() as folder:
        trainer = BaselineTrainer(make_pendulum, our_config(steps, episodes), seed, Path(folder))
        last = trainer.run()
        our_training = float(np.mean([row["train/cost"] for row in trainer.metrics.rows]))
    model = sac(
        "MlpPolicy", gymnasium.make(TASK), learning_rate=RATE, buffer_size=steps, learning_starts=FIRST,
        batch_size=BATCH, tau=TAU, gamma=0.99, seed=seed, device="cpu", stats_window_size=10**6,
        policy_kwargs={"net_arch": [HIDDEN, HIDDEN]},
    )  # fmt: skip
    model.learn(steps)
    their_training = -float(np.mean([episode["r"] for episode in model.ep_info_buffer or ()]))
    envs = make_pendulum(episodes, seed)
    start = derive_seed(seed, Purpose.FINAL_EVALUATION)
    their_cost = episode_costs(collect_episodes(envs, TheirPolicy(model), start, record=False)).mean()
    times = time_in_turns(
        {OURS: trainer.learn, THEIRS: lambda updates: model.train(updates, BATCH)}, BLOCKS, BLOCK_UPDATES
    )
    return {
        OURS: SeedResult(last["evaluation/cost"], our_training, *times[OURS]),
        THEIRS: SeedResult(float(their_cost), their_training, *times[THEIRS]),
    }


def time_in_turns(
    learners: dict[str, Callable[[int], Any]], blocks: int, updates: int
) -> dict[str, tuple[float, float]]:
    """Time updates in blocks that take turns.

    Args:
        learners: Name to what makes a number of updates.
        blocks: Of each.
        updates: Of a block.

    Returns:
        Name to the medians of CPU and wall-clock time of an update [ms].
    """
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in learners}
    for _ in range(blocks):
        for name, learn in learners.items():
            cpu, wall = time.process_time(), time.perf_counter()
            learn(updates)
            spent[name].append((time.process_time() - cpu, time.perf_counter() - wall))
    medians = {name: np.median(np.array(pairs), axis=0) / updates * 1e3 for name, pairs in spent.items()}
    return {name: (float(median[0]), float(median[1])) for name, median in medians.items()}


def compare(
    seeds: Sequence[int], steps: int, episodes: int, report: Callable[[str], None] = print
) -> dict[str, Any]:
    """Train both with all seeds.

    Args:
        seeds: Of the trainings.
        steps: Environment steps of each.
        episodes: Noise-free episodes at the end of each.
        report: Told a line for every seed.

    Returns:
        For both: every seed's `SeedResult`, and mean and 95 % interval of each of its entries.

    Raises:
        ExperimentError: A number is out of range, or stable-baselines3 is not installed.
    """
    if steps < 2 * EPISODE_STEPS or steps % EPISODE_STEPS:
        raise ExperimentError(f"--steps {steps}: give a multiple of {EPISODE_STEPS}, at least two episodes")
    if episodes < 1 or len(set(seeds)) < len(seeds):
        raise ExperimentError(
            f"--episodes {episodes}, --seeds {list(seeds)}: give at least 1, and no seed twice"
        )
    _stable_baselines3()
    torch.set_num_threads(1)
    results: dict[str, list[SeedResult]] = {OURS: [], THEIRS: []}
    for seed in seeds:
        for name, result in compare_seed(seed, steps, episodes).items():
            results[name].append(result)
            report(
                f"seed {seed}, {name}: cost {result.cost:.1f}, in training {result.training_cost:.1f}, "
                f"{result.cpu_ms:.2f} CPU ms an update"
            )
    return {"task": TASK, "steps": steps, "episodes": episodes, "seeds": list(seeds)} | {
        name: _summary(of_seeds) for name, of_seeds in results.items()
    }


def _summary(results: list[SeedResult]) -> dict[str, Any]:
    summary: dict[str, Any] = {"runs": [asdict(result) for result in results]}
    for entry in summary["runs"][0]:
        mean, low, high = mean_with_band(np.array([run[entry] for run in summary["runs"]]))
        interval = [low, high] if len(results) > 1 else None
        summary[entry] = {"mean": mean, "interval_95": interval}
    return summary


def _stable_baselines3() -> Any:
    try:
        from stable_baselines3 import SAC  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ExperimentError(
            'stable-baselines3 is not installed; get it with pip install -e ".[bench]"'
        ) from error
    return SAC


def _as_text(result: dict[str, Any]) -> str:
    lines = [f"{TASK}, {result['steps']} steps, {len(result['seeds'])} seeds, mean [95 % interval]"]
    for name in (OURS, THEIRS):
        parts = []
        for entry in ("cost", "training_cost", "cpu_ms", "wall_ms"):
            value = result[name][entry]
            limits = value["interval_95"]
            band = "" if limits is None else f" [{limits[0]:.2f}, {limits[1]:.2f}]"
            parts.append(f"{entry} {value['mean']:.2f}{band}")
        lines.append(f"{name:18s} " + ", ".join(parts))
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Compare our SAC with that of stable-baselines3.")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--steps", type=int, default=10_000, help="environment steps of a training")
    parser.add_argument("--episodes", type=int, default=100, help="noise-free episodes after a training")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    try:
        result = compare(
            args.seeds, args.steps, args.episodes, lambda line: print(line, file=sys.stderr, flush=True)
        )
    except (ExperimentError, BaselineConfigError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(json.dumps({**result, "provenance": provenance()}) if args.json else _as_text(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
