"""Training of a baseline: act, store, learn, evaluate; stoppable at any moment and resumed bit for bit."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from baselines.collection import EpisodeRound
from baselines.config import BaselineConfig
from baselines.model_files import StoredNetworks, write_networks
from baselines.policy import ActionScale, BaselinePolicy
from baselines.registry import make_learner
from baselines.replay import Replay
from baselines.replay_files import read_replay, write_replay
from baselines.trained import trained_policy
from deepkoco import __version__
from deepkoco.agent.buffer import Episode
from deepkoco.agent.checkpoint import (
    CheckpointError,
    check_settings,
    damaged,
    load_checkpoint,
    save_checkpoint,
)
from deepkoco.agent.collection import (
    VectorEnvFactory,
    box_sizes,
    collect_episodes,
    cost_spread,
    episode_costs,
)
from deepkoco.agent.environment_pool import EnvironmentPool
from deepkoco.agent.metrics import MetricsLog, Row, evaluation_metrics
from deepkoco.agent.references.measure import Trained
from deepkoco.agent.references.run_comparison import compare_run
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.agent.standing import Report, Standing
from deepkoco.agent.stopwatch import Stopwatch
from deepkoco.agent.stored_controller import MODEL_FOLDER

CHECKPOINT_FILE = "checkpoint.pt"
REPORT_STEPS = 50


@dataclass
class Progress:
    """Where a run stands, at the end of an episode.

    Attributes:
        rounds: Finished rounds of episodes.
        episodes: Finished episodes.
        parts: Files of the replay.
        rows: Rows of the replay that are in these files.
        transitions: Transitions that are in these files.
        seconds: Time spent, over all resumptions [s].
        processor_seconds: The same of processors; runs of earlier releases begin to count when they are resumed [s].
    """

    rounds: int = 0
    episodes: int = 0
    parts: int = 0
    rows: int = 0
    transitions: int = 0
    seconds: float = 0.0
    processor_seconds: float = 0.0


class BaselineTrainer:
    """One training run in one folder.

    A round is one episode in each of `environments`; its environments are reset with a seed derived from (run
    seed, round). A checkpoint falls between two rounds, so no state of an environment belongs to it: a run that was
    killed repeats what it did since, with the same outcome.
    """

    def __init__(
        self,
        make_envs: VectorEnvFactory,
        config: BaselineConfig,
        seed: int,
        folder: Path,
        make_evaluation_envs: VectorEnvFactory | None = None,
        task: Mapping[str, Any] | None = None,
    ) -> None:
        """Set up, and continue where the folder's checkpoint stands if there is one.

        Args:
            make_envs: Makes environments from (count, seed).
            config: Hyper-parameters; its name says which baseline.
            seed: The run's seed.
            folder: The run's folder; it exists.
            make_evaluation_envs: Makes those of the evaluations, by default the same.
            task: What the exported model says of its task.

        Raises:
            BaselineConfigError: A hyper-parameter is out of range.
            SpaceError: The environment's spaces do not fit.
            CheckpointError: The checkpoint belongs to other settings or another seed.
        """
        config.check()
        self.config, self.seed, self.folder = config, seed, folder
        self._make_envs, self._task = make_envs, dict(task or {})
        self._make_evaluation_envs = make_evaluation_envs or make_envs
        self._pool = EnvironmentPool(seed)
        count = min(config.environments, config.total_episodes)
        self._shape, self._low, self._high = box_sizes(self._pool.get(count, make_envs))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(derive_seed(seed, Purpose.WEIGHTS))
            self.learner = make_learner(self._shape, self._low.size, config)
        self._frames = config.frames if len(self._shape) == 3 else 1
        self._replay = Replay(self._shape, self._low.size, self._frames)
        self._sampling = torch.Generator().manual_seed(derive_seed(seed, Purpose.SAMPLING))
        self._noise = torch.Generator().manual_seed(derive_seed(seed, Purpose.NOISE))
        self._logged: defaultdict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])  # sum and count
        self._costs: list[float] = []
        self.progress = Progress()
        rows: list[Row] = []
        if (folder / CHECKPOINT_FILE).exists():
            state = load_checkpoint(folder / CHECKPOINT_FILE)
            try:
                rows = self._restore(state)
            except CheckpointError:
                raise
            except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
                raise damaged(folder / CHECKPOINT_FILE, error) from error
        self.metrics = MetricsLog(folder, rows)

    @property
    def finished(self) -> bool:
        """Whether all episodes are collected and learned from."""
        return self.progress.episodes >= self.config.total_episodes

    @property
    def policy(self) -> BaselinePolicy:
        """The present actor without exploration."""
        learner = self.learner
        return BaselinePolicy(learner.actor, learner.critic, self._shape, self._frames, self._low, self._high)

    def run(self, report: Report | None = None) -> Row:
        """Train to the end, evaluate, compare with references and export the networks into the folder `model`.

        Args:
            report: Called now and then, for a progress display.

        Returns:
            The last metrics row.
        """
        watch = Stopwatch(self.progress)
        tell = report or _tell_nobody
        while not self.finished:
            before = self.progress.episodes
            self._round(tell)
            row = None
            if self._passed(before, self.config.evaluation_every):
                row = self._evaluate(watch)
            if row is not None or self._passed(before, self.config.checkpoint_episodes):
                self._save(watch)
            tell(self._standing(f"training cost {self._last_cost():.0f}", row))
        if not (self.folder / MODEL_FOLDER).exists():
            self._export(self._compare())
        self._pool.close()
        self.metrics.close()
        return self.metrics.rows[-1]

    def learn(self, updates: int) -> None:
        """Update on what the replay holds.

        Args:
            updates: How many; none below 1.
        """
        for _ in range(updates):
            batch = self._replay.sample(self.config.batch, self._sampling)
            batch = batch.with_scaled_rewards(self.config.reward_scale)
            for name, value in self.learner.update(batch, self._sampling).items():
                sums = self._logged[name]
                sums[0] += value
                sums[1] += 1.0

    def _round(self, tell: Report) -> None:
        """One episode in each environment, with the updates that are due at every step."""
        config, progress = self.config, self.progress
        count = min(config.environments, config.total_episodes - progress.episodes)
        seed = derive_seed(self.seed, Purpose.TRAINING_EPISODES, progress.rounds)
        envs = self._pool.get(count, self._make_envs)
        episodes = EpisodeRound(envs, self._replay, self._shape, self._frames, self._low, self._high)
        episodes.start(seed)
        while episodes.running.any():
            before = len(self._replay)
            episodes.step(self.learner, self._noise, random=before < config.random_steps)
            self.learn(self._due(len(self._replay)) - self._due(before))
            if len(self._replay) % REPORT_STEPS < count:
                tell(self._standing(f"episode {progress.episodes + 1}"))
        self._costs += episodes.costs.tolist()
        progress.rounds += 1
        progress.episodes += count

    def _due(self, steps: int) -> int:
        """Updates that belong to the first steps of the run."""
        return max(0, steps - self.config.random_steps) // self.config.steps_per_update

    def _evaluate(self, watch: Stopwatch) -> Row:
        """Noise-free episodes; adds a row of metrics with what happened since the last one."""
        config = self.config
        count = config.final_evaluation_episodes if self.finished else config.evaluation_episodes
        purpose = Purpose.FINAL_EVALUATION if self.finished else Purpose.EVALUATION
        costs = np.full(1, np.nan)
        if count:
            envs = self._pool.get(count, self._make_evaluation_envs)
            costs = episode_costs(
                collect_episodes(envs, self.policy, derive_seed(self.seed, purpose), record=False)
            )
        train = np.array(self._costs)
        row = {
            "episodes": self.progress.episodes,
            "steps": len(self._replay),
            "updates": self.learner.updates,
            "train/cost": float(train.mean()),
            "train/cost_sd": cost_spread(train),
            **{name: self._mean(name) for name in self.learner.logged},
            **evaluation_metrics(costs, count),
            **watch.row(),
        }
        self.metrics.add(row)
        self._costs.clear()
        self._logged.clear()
        return row

    def _mean(self, name: str) -> float:
        total, count = self._logged[name]
        return total / count if count else float("nan")

    def _passed(self, before: int, every: int) -> bool:
        """Whether the last round reached or passed a multiple of `every` episodes, or the end of the run."""
        return self.finished or self.progress.episodes // every > before // every

    def _last_cost(self) -> float:
        return self._costs[-1] if self._costs else self.metrics.rows[-1]["train/cost"]

    def _standing(self, text: str, row: Row | None = None) -> Standing:
        return Standing(self.progress.episodes, self.config.total_episodes, text, row)

    def _save(self, watch: Stopwatch) -> None:
        progress = self.progress
        if self._replay.rows > progress.rows:
            write_replay(self.folder, progress.parts, self._replay.since(progress.rows, progress.transitions))
            progress.parts += 1
            progress.rows, progress.transitions = self._replay.rows, len(self._replay)
        watch.note(progress)
        save_checkpoint(
            self.folder / CHECKPOINT_FILE,
            {
                "config": asdict(self.config),
                "seed": self.seed,
                "learner": self.learner.state_dict(),
                "sampling": self._sampling.get_state(),
                "noise": self._noise.get_state(),
                "progress": asdict(progress),
                "logged": dict(self._logged),
                "costs": self._costs,
                "metrics": self.metrics.rows,
            },
        )

    def _restore(self, state: dict[str, Any]) -> list[Row]:
        defaults = asdict(type(self.config)())
        check_settings(self.folder / CHECKPOINT_FILE, state, asdict(self.config), self.seed, defaults)
        self.learner.load_state_dict(state["learner"])
        self._sampling.set_state(state["sampling"])
        self._noise.set_state(state["noise"])
        self.progress = Progress(**state["progress"])
        read_replay(self.folder, self.progress.parts, self._replay)
        self._logged.update(state["logged"])
        self._costs = state["costs"]
        return state["metrics"]

    def _compare(self) -> dict[str, str]:
        def trained() -> Trained:
            config, low, high = self.config, self._low, self._high
            scale = ActionScale(low, high)
            first = [
                Episode(o, torch.from_numpy(scale.to_environment(a.numpy())).float(), -r)
                for o, a, r in self._replay.episodes(config.random_steps)
            ]
            return trained_policy(
                config.name,
                config.total_episodes,
                self.policy,
                first,
                self.metrics.rows,
                low,
                high,
                self.seed,
            )

        return compare_run(
            trained,
            lambda count: self._pool.get(count, self._make_evaluation_envs),
            self.config.final_evaluation_episodes,
            self.config.reference_episodes,
            self.seed,
            self.folder,
        )

    def _export(self, comparison: dict[str, str]) -> None:
        training = {
            "seed": self.seed,
            "episodes": self.progress.episodes,
            "updates": self.learner.updates,
            **comparison,
            "package": f"deepkoco {__version__}",
        }
        learner = self.learner
        networks = StoredNetworks(
            self.config, learner.actor, learner.critic, self._shape, self._low, self._high
        )
        write_networks(networks, self.folder / MODEL_FOLDER, self._task, training)


def _tell_nobody(standing: Standing) -> None:
    pass
