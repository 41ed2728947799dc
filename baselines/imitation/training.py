"""Training by questions: act, ask, learn, evaluate; stoppable at any moment and resumed bit for bit."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from baselines.imitation.asking import Always, make_rule
from baselines.imitation.config import ImitationConfig
from baselines.imitation.learner import Learner
from baselines.imitation.lessons import Lesson, give_lesson
from baselines.imitation.policy import ImitationPolicy, make_ensemble, write_policy
from baselines.imitation.teachers import Teacher, make_teacher
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
from deepkoco.agent.stored_controller import MODEL_FOLDER

CHECKPOINT_FILE = "checkpoint.pt"
RANDOM_EPISODES = 20  # that EDMDc is fitted to, at the end


@dataclass
class Progress:
    """Where a run stands, at the end of a round.

    Attributes:
        rounds: Finished rounds, the demonstrations among them.
        episodes: Finished episodes.
        steps: Steps of episodes.
        queries: Questions so far.
        unanswered: Those of them without an answer.
        seconds: Time spent, over all resumptions [s].
    """

    rounds: int = 0
    episodes: int = 0
    steps: int = 0
    queries: int = 0
    unanswered: int = 0
    seconds: float = 0.0


class ImitationTrainer:
    """One training run in one folder.

    The first round is demonstrated: the teacher acts and every step is a question. In every later round the student
    acts and the rule asks. Behind each round the ensemble is fitted to all answers. A checkpoint falls between two
    rounds.
    """

    def __init__(
        self,
        make_envs: VectorEnvFactory,
        config: ImitationConfig,
        seed: int,
        folder: Path,
        make_evaluation_envs: VectorEnvFactory | None = None,
        task: Mapping[str, Any] | None = None,
        teacher: Teacher | None = None,
    ) -> None:
        """Start where the folder's checkpoint stands if there is one.

        Args:
            make_envs: Makes environments from (count, seed).
            config: Settings.
            seed: The run's seed.
            folder: The run's folder; it exists.
            make_evaluation_envs: Makes those of the evaluations, by default the same.
            task: What the exported policy says of its task.
            teacher: Answers; by default the one that the settings name.

        Raises:
            BaselineConfigError: A setting is out of range, or there is no such teacher.
            SpaceError: The environment's spaces do not fit.
            CheckpointError: The checkpoint belongs to other settings or another seed.
        """
        config.check()
        self.config, self.seed, self.folder = config, seed, folder
        self._make_envs, self._task = make_envs, dict(task or {})
        self._make_evaluation_envs = make_evaluation_envs or make_envs
        self._pool = EnvironmentPool(seed)
        shape, self._low, self._high = box_sizes(self._pool.get(config.environments, make_envs))
        if len(shape) != 1:
            raise SpaceError(
                f"observations have shape {shape}; imitation learns from states: leave out observation=images"
            )
        self._teacher = teacher or make_teacher(config.teacher, config.answer_delay)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(derive_seed(seed, Purpose.WEIGHTS))
            self.learner = Learner(make_ensemble(shape[0], self._low, self._high, config), config)
        self._sampling = torch.Generator().manual_seed(derive_seed(seed, Purpose.SAMPLING))
        self._noise = torch.Generator().manual_seed(derive_seed(seed, Purpose.NOISE))
        self._rule = make_rule(config, self._noise)
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
        """Whether all episodes are over, or all questions asked."""
        budget = self.config.query_budget
        spent = budget is not None and self.progress.queries >= budget
        return self.progress.episodes >= self.config.total_episodes or spent

    @property
    def policy(self) -> ImitationPolicy:
        """The present student, which asks nobody."""
        return ImitationPolicy(self.learner.ensemble)

    def run(self, report: Report | None = None) -> Row:
        """Train to the end, evaluate, compare with references and export the policy into the folder `model`.

        Args:
            report: Called now and then, for a progress display.

        Returns:
            The last metrics row.
        """
        started = time.perf_counter() - self.progress.seconds
        tell = report or _tell_nobody
        try:
            while not self.finished:
                before = self.progress.episodes
                lesson, loss = self._round()
                row = None
                if self._passed(before, self.config.evaluation_every):
                    row = self._evaluate(lesson, loss, started)
                if row is not None or self._passed(before, self.config.checkpoint_episodes):
                    self._save(started)
                asked = f"{self.progress.queries} questions"
                if row is not None:
                    asked += f", noise-free cost {row['evaluation/cost']:.3g}"
                tell(self._standing(asked, row))
        finally:
            self._teacher.close()
        if not (self.folder / MODEL_FOLDER).exists():
            self._export(self._compare())
        self._pool.close()
        self.metrics.close()
        return self.metrics.rows[-1]

    def _round(self) -> tuple[Lesson, float]:
        """Episodes and the fit behind them; the lesson, and the error of the fit."""
        config, progress, learner = self.config, self.progress, self.learner
        shown = progress.rounds == 0
        envs = self._pool.get(config.demonstrations if shown else config.environments, self._make_envs)
        left = None if config.query_budget is None else config.query_budget - progress.queries
        lesson = give_lesson(
            envs,
            derive_seed(self.seed, Purpose.TRAINING_EPISODES, progress.rounds),
            learner.ensemble,
            learner.labels,
            Always() if shown else self._rule,
            self._teacher,
            shown or config.teacher_acts,
            left,
        )
        learner.add(lesson.answered, self._noise)
        loss = learner.fit(self._sampling)
        progress.rounds += 1
        progress.episodes += len(lesson.costs)
        progress.steps += lesson.steps
        progress.queries += lesson.asked
        progress.unanswered += lesson.unanswered
        self._costs += lesson.costs.tolist()
        return lesson, loss

    def _evaluate(self, lesson: Lesson, loss: float, started: float) -> Row:
        """Noise-free episodes; adds a row of metrics with what happened since the last one."""
        config, progress = self.config, self.progress
        count = config.final_evaluation_episodes if self.finished else config.evaluation_episodes
        purpose = Purpose.FINAL_EVALUATION if self.finished else Purpose.EVALUATION
        costs = np.full(1, np.nan)
        if count:
            envs = self._pool.get(count, self._make_evaluation_envs)
            costs = episode_costs(
                collect_episodes(envs, self.policy, derive_seed(self.seed, purpose), record=False)
            )
        train, threshold = np.array(self._costs), self._rule.threshold
        row = {
            "episodes": progress.episodes,
            "steps": progress.steps,
            "queries": progress.queries,
            "unanswered": progress.unanswered,
            "updates": self.learner.updates,
            "train/cost": float(train.mean()),
            "train/cost_sd": cost_spread(train),
            "loss/imitation": loss,
            "ask/share": lesson.asked / lesson.steps,
            "ask/threshold": math.nan if threshold is None else threshold.value,
            "ask/doubt": lesson.doubts,
            **evaluation_metrics(costs, count),
            "seconds": time.perf_counter() - started,
        }
        self.metrics.add(row)
        self._costs.clear()
        return row

    def _passed(self, before: int, every: int) -> bool:
        """Whether the last round reached or passed a multiple of `every` episodes, or the end of the run."""
        return self.finished or self.progress.episodes // every > before // every

    def _standing(self, text: str, row: Row | None = None) -> Standing:
        total = self.config.total_episodes
        return Standing(min(self.progress.episodes, total), total, text, row)

    def _save(self, started: float) -> None:
        threshold = self._rule.threshold
        self.progress.seconds = time.perf_counter() - started
        save_checkpoint(
            self.folder / CHECKPOINT_FILE,
            {
                "config": asdict(self.config),
                "seed": self.seed,
                "learner": self.learner.state_dict(),
                "sampling": self._sampling.get_state(),
                "noise": self._noise.get_state(),
                "threshold": None if threshold is None else threshold.value,
                "progress": asdict(self.progress),
                "costs": self._costs,
                "metrics": self.metrics.rows,
            },
        )

    def _restore(self, state: dict[str, Any]) -> list[Row]:
        check_settings(
            self.folder / CHECKPOINT_FILE, state, asdict(self.config), self.seed, asdict(ImitationConfig())
        )
        self.learner.load_state_dict(state["learner"])
        self._sampling.set_state(state["sampling"])
        self._noise.set_state(state["noise"])
        if self._rule.threshold is not None:
            self._rule.threshold.value = state["threshold"]
        self.progress = Progress(**state["progress"])
        self._costs = state["costs"]
        return state["metrics"]

    def _compare(self) -> dict[str, str]:
        config, low, high = self.config, self._low, self._high

        def trained() -> Trained:
            # A run has no random episodes: those that EDMDc is fitted to are made here.
            seed = derive_seed(self.seed, Purpose.TRAINING_EPISODES, self.progress.rounds)
            envs = self._pool.get(RANDOM_EPISODES, self._make_envs)
            first = collect_episodes(envs, UniformActions(low, high, RANDOM_EPISODES, seed), seed)
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
            "teacher": self.config.teacher,
            "episodes": self.progress.episodes,
            "questions": self.progress.queries,
            "updates": self.learner.updates,
            **comparison,
            "package": f"deepkoco {__version__}",
        }
        write_policy(self.folder / MODEL_FOLDER, self.config, self.learner.ensemble, self._task, training)


def _tell_nobody(standing: Standing) -> None:
    pass
