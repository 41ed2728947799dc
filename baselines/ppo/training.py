"""Training of PPO: roll out, learn, evaluate; stoppable at any moment and resumed bit for bit."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from baselines.ppo.collection import Collector, EpisodeCosts
from baselines.ppo.config import PpoConfig
from baselines.ppo.learner import PpoLearner
from baselines.ppo.networks import ActorCritic
from baselines.ppo.policy import PpoPolicy, write_policy
from baselines.ppo.scaling import ScaledRewards
from baselines.trained import UniformActions, trained_policy
from deepkoco import __version__
from deepkoco.agent.checkpoint import (
    CheckpointError,
    check_settings,
    damaged,
    load_checkpoint,
    save_checkpoint,
)
from deepkoco.agent.collection import (
    SpaceError,
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


@dataclass
class Progress:
    """Where a run stands, at the end of a round.

    Attributes:
        rounds: Finished rounds.
        episodes: Finished episodes.
        steps: Steps of episodes.
        seconds: Time spent, over all resumptions [s].
        processor_seconds: The same of processors; runs of earlier releases begin to count when they are resumed [s].
    """

    rounds: int = 0
    episodes: int = 0
    steps: int = 0
    seconds: float = 0.0
    processor_seconds: float = 0.0


class PpoTrainer:
    """One training run in one folder.

    A round resets all environments with a seed derived from (run seed, round) and makes rollouts, each followed by
    an update, until every environment has ended an episode. A checkpoint falls between two rounds, so no state of an
    environment belongs to it: a run that was killed repeats what it did since, with the same outcome.
    """

    def __init__(
        self,
        make_envs: VectorEnvFactory,
        config: PpoConfig,
        seed: int,
        folder: Path,
        make_evaluation_envs: VectorEnvFactory | None = None,
        task: Mapping[str, Any] | None = None,
    ) -> None:
        """Start where the folder's checkpoint stands if there is one.

        Args:
            make_envs: Makes environments from (count, seed).
            config: Hyper-parameters.
            seed: The run's seed.
            folder: The run's folder; it exists.
            make_evaluation_envs: Makes those of the evaluations, by default the same.
            task: What the exported policy says of its task.

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
        envs = self._pool.get(config.environments, make_envs)
        shape, self._low, self._high = box_sizes(envs)
        if len(shape) != 1:
            raise SpaceError(
                f"observations have shape {shape}; PPO acts on states: leave out observation=images"
            )
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(derive_seed(seed, Purpose.WEIGHTS))
            self.learner = PpoLearner(ActorCritic(shape[0], self._low, self._high, config), config)
        rewards = ScaledRewards(
            config.environments, config.discount, config.reward_limit, config.scale_rewards
        )
        self._collector = Collector(envs, self.learner.networks, rewards, config)
        self._costs = EpisodeCosts(config.environments)
        self._sampling = torch.Generator().manual_seed(derive_seed(seed, Purpose.SAMPLING))
        self._noise = torch.Generator().manual_seed(derive_seed(seed, Purpose.NOISE))
        self._logged: defaultdict[str, list[float]] = defaultdict(list)
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
    def policy(self) -> PpoPolicy:
        """The present policy without exploration."""
        return PpoPolicy(self.learner.networks)

    def run(self, report: Report | None = None) -> Row:
        """Train to the end, evaluate, compare with references and export the policy into the folder `model`.

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
            if row is not None:
                tell(self._standing(f"training cost {row['train/cost']:.0f}", row))
        if not (self.folder / MODEL_FOLDER).exists():
            self._export(self._compare())
        self._pool.close()
        self.metrics.close()
        return self.metrics.rows[-1]

    def _round(self, tell: Report) -> None:
        """Rollouts from a reset of all environments until each has ended an episode, with an update on each."""
        progress, config = self.progress, self.config
        self._collector.start(derive_seed(self.seed, Purpose.TRAINING_EPISODES, progress.rounds))
        self._costs.start()
        left = 1.0 - progress.episodes / config.total_episodes
        rate = config.learning_rate * (config.final_learning_rate + left * (1.0 - config.final_learning_rate))
        while not self._costs.ended.all():
            rollout, samples = self._collector.run(self._noise)
            orders = (torch.randperm(len(samples), generator=self._sampling) for _ in range(config.epochs))
            for name, value in self.learner.update(samples, orders, rate).items():
                self._logged[name].append(value)
            self._collector.follow(rollout)
            progress.episodes += self._costs.add(rollout.rewards, rollout.ended)
            progress.steps += len(samples)
            tell(self._standing(f"episode {progress.episodes}"))
        progress.rounds += 1

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
        train = np.array(self._costs.finished)
        row = {
            "episodes": self.progress.episodes,
            "steps": self.progress.steps,
            "updates": self.learner.updates,
            "train/cost": float(train.mean()),
            "train/cost_sd": cost_spread(train),
            **{name: float(np.mean(self._logged[name])) for name in self.learner.logged},
            **evaluation_metrics(costs, count),
            **watch.row(),
        }
        self.metrics.add(row)
        self._costs.finished.clear()
        self._logged.clear()
        return row

    def _passed(self, before: int, every: int) -> bool:
        """Whether the last round reached or passed a multiple of `every` episodes, or the end of the run."""
        return self.finished or self.progress.episodes // every > before // every

    def _standing(self, text: str, row: Row | None = None) -> Standing:
        total = self.config.total_episodes
        return Standing(min(self.progress.episodes, total), total, text, row)

    def _save(self, watch: Stopwatch) -> None:
        watch.note(self.progress)
        save_checkpoint(
            self.folder / CHECKPOINT_FILE,
            {
                "config": asdict(self.config),
                "seed": self.seed,
                "learner": self.learner.state_dict(),
                "rewards": self._collector.rewards.moments.state_dict(),
                "sampling": self._sampling.get_state(),
                "noise": self._noise.get_state(),
                "progress": asdict(self.progress),
                "logged": dict(self._logged),
                "costs": self._costs.finished,
                "metrics": self.metrics.rows,
            },
        )

    def _restore(self, state: dict[str, Any]) -> list[Row]:
        check_settings(
            self.folder / CHECKPOINT_FILE, state, asdict(self.config), self.seed, asdict(PpoConfig())
        )
        self.learner.load_state_dict(state["learner"])
        self._collector.rewards.moments.load_state_dict(state["rewards"])
        self._sampling.set_state(state["sampling"])
        self._noise.set_state(state["noise"])
        self.progress = Progress(**state["progress"])
        self._logged.update(state["logged"])
        self._costs.finished = state["costs"]
        return state["metrics"]

    def _compare(self) -> dict[str, str]:
        config, low, high = self.config, self._low, self._high

        def trained() -> Trained:
            # A run has no random episodes: those that EDMDc is fitted to are made here, one in each environment.
            seed = derive_seed(self.seed, Purpose.TRAINING_EPISODES, self.progress.rounds)
            envs = self._pool.get(config.environments, self._make_envs)
            first = collect_episodes(envs, UniformActions(low, high, config.environments, seed), seed)
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
            config.final_evaluation_episodes,
            config.reference_episodes,
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
        write_policy(self.folder / MODEL_FOLDER, self.config, self.learner.networks, self._task, training)


def _tell_nobody(standing: Standing) -> None:
    pass
