"""Training: collect, fit, evaluate, repeat; stoppable at any moment and resumed bit for bit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepkoco import __version__
from deepkoco.agent.agent import VectorAgent
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
from deepkoco.agent.config import OLDER_SETTINGS, TrainingConfig
from deepkoco.agent.controllers import Controllers
from deepkoco.agent.eigenvalue_history import EigenvalueHistory
from deepkoco.agent.environment_pool import EnvironmentPool
from deepkoco.agent.experience import Experience
from deepkoco.agent.exploration import annealed_variance
from deepkoco.agent.first_episodes import (
    collect_first,
    make_noise,
    random_count,
)
from deepkoco.agent.kept_weights import KeptWeights
from deepkoco.agent.learner import Learner
from deepkoco.agent.linear_candidates import fit_candidates
from deepkoco.agent.metrics import MetricsLog, Row, evaluation_metrics
from deepkoco.agent.planner_metrics import planner_metrics
from deepkoco.agent.progress import Progress
from deepkoco.agent.references.run_comparison import compare_run
from deepkoco.agent.replay_files import read_replay
from deepkoco.agent.schedule import planned_updates, step_size
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.agent.standing import Report, Standing
from deepkoco.agent.stopwatch import Stopwatch
from deepkoco.agent.stored_controller import MODEL_FOLDER, StoredController, write_controller
from deepkoco.agent.task_scale import action_unit
from deepkoco.agent.trained import trained_deepkoco
from deepkoco.koopman.model.model import KoopmanModel

CHECKPOINT_FILE = "checkpoint.pt"
BEFORE_END_FILE = "before_end.pt"
"""The checkpoint from which a finished run can be prolonged: nothing that only an end does is in it."""
LOSS_NAMES = ("linear", "cost_reconstruction", "cost_prediction", "latent_scale", "inverse")


class Trainer:
    """One training run in one folder.

    Each iteration resets the environments with a seed derived from (run seed, iteration), and makes its
    planners anew, so neither belongs to a checkpoint. Weights, optimiser, generators, counters and metrics
    do; the episodes of an iteration are written once, before the checkpoint that counts on them.

    Source: DeepKoCo, Alg. 8.
    """

    def __init__(
        self,
        make_envs: VectorEnvFactory,
        config: TrainingConfig,
        seed: int,
        folder: Path,
        make_evaluation_envs: VectorEnvFactory | None = None,
        task: Mapping[str, Any] | None = None,
    ) -> None:
        """Set up, and continue where the folder's checkpoint stands if there is one.

        Args:
            make_envs: Makes environments from (count, seed).
            config: Hyper-parameters.
            seed: The run's seed.
            folder: The run's folder; it exists.
            make_evaluation_envs: Makes those of the evaluations, by default the same: with other distractors
                they tell what was learned from what was memorised.
            task: What the exported model says of its task: name, id, kwargs, distractors, observation.

        Raises:
            TrainingConfigError: A hyper-parameter is out of range.
            SpaceError: The environment's spaces do not fit.
            CheckpointError: The checkpoint belongs to other settings or another seed.
        """
        config.check()
        self.config, self.seed, self.folder = config, seed, folder
        self._make_envs, self._task = make_envs, dict(task or {})
        self._make_evaluation_envs = make_evaluation_envs or make_envs
        self._pool = EnvironmentPool(seed)
        observation, self._low, self._high = box_sizes(self._pool.get(random_count(config), make_envs))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(derive_seed(seed, Purpose.WEIGHTS))
            unit = action_unit(self._low, self._high) if config.scale else np.ones_like(self._low)
            limits = self._low / unit, self._high / unit
            self._learner = Learner(observation, self._low.size, config, limits)
        recordings = 1 if self._learner.model.frame_encoder is None else config.model.frames
        self._experience = Experience(folder, config, recordings, self._low, self._high)
        self._buffer = self._experience.buffer
        self._controllers = Controllers(self._experience, self._learner, self._low, self._high)
        self._sampling = torch.Generator().manual_seed(derive_seed(seed, Purpose.SAMPLING))
        self._noise = torch.Generator().manual_seed(derive_seed(seed, Purpose.NOISE))
        self._collected: Row = {}
        self._kept = KeptWeights()
        self._loss_sums = torch.zeros(len(LOSS_NAMES), dtype=torch.float64, device=config.device)
        self.progress = Progress()
        rows, eigenvalues = [], []
        if (folder / CHECKPOINT_FILE).exists():
            state = load_checkpoint(folder / CHECKPOINT_FILE)
            try:
                rows, eigenvalues = self._restore(state)
            except CheckpointError:
                raise
            except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
                raise damaged(folder / CHECKPOINT_FILE, error) from error
        self.metrics = MetricsLog(folder, rows)
        self.eigenvalues = EigenvalueHistory(folder, eigenvalues)
        if not eigenvalues and not self.progress.updates:
            self._note_eigenvalues()

    @property
    def finished(self) -> bool:
        """Whether all episodes are collected and learned from."""
        return not self.progress.collected and len(self._buffer) >= self.config.total_episodes

    @property
    def averaged_model(self) -> KoopmanModel:
        """The model that acts: moving average of the weights."""
        return self._learner.averaged

    def run(self, report: Report | None = None) -> Row:
        """Train to the end, evaluate, compare with references and export the model into the folder `model`.

        Args:
            report: Called now and then, for a progress display.

        Returns:
            The last metrics row.

        Raises:
            ReplayError: No collected episode is as long as a training window.
        """
        watch = Stopwatch(self.progress)
        while not self.finished:
            if not self.progress.collected:
                self._collect()
                self._save(watch)
                note = "" if self.progress.iteration else self._experience.decision
                if report is not None and note:
                    report(replace(self._standing(self._planned_updates()), note=note))
            planned = self._planned_updates()
            while self.progress.iteration_updates < planned:
                self._update(planned)
                if self.progress.iteration_updates % self.config.checkpoint_updates == 0:
                    self._save(watch)
                if report is not None and self.progress.iteration_updates % 50 == 0:
                    report(self._standing(planned))
            if len(self._buffer) >= self.config.total_episodes:
                self._save(watch, BEFORE_END_FILE)
            standing = self._standing(planned)
            self._finish_iteration(planned, watch)
            self._save(watch)
            if report is not None:
                report(replace(standing, row=self.metrics.rows[-1]))
        if not (self.folder / MODEL_FOLDER).exists():
            self._export(self._compare())
        self._pool.close()
        self.metrics.close()
        return self.metrics.rows[-1]

    def _standing(self, planned: int) -> Standing:
        text = f"iteration {self.progress.iteration + 1}, training cost {self._collected['train/cost']:.0f}"
        return Standing(self.progress.iteration_updates, planned, text)

    def _collect(self) -> None:
        config, done, iteration = self.config, len(self._buffer), self.progress.iteration
        variance = annealed_variance(config.noise_variance, done, config.noise_last_episode)
        noise = partial(
            make_noise, config, variance=variance, low=self._low, high=self._high, generator=self._noise
        )
        if iteration == 0:
            envs = partial(self._pool.get, make=self._make_envs)
            episodes, failures = collect_first(config, envs, self._low, self._high, noise, self.seed)
        else:
            count = min(config.iteration_episodes, config.total_episodes - done)
            seed = derive_seed(self.seed, Purpose.TRAINING_EPISODES, iteration)
            agent = self._controllers.exploring(count, seed, noise, self._kept.linear)
            episodes = collect_episodes(self._pool.get(count, self._make_envs), agent, seed)
            failures = agent.failures
        self._experience.add(iteration, episodes)
        costs = episode_costs(episodes)
        self._collected = {
            "train/cost": float(costs.mean()),
            "train/cost_sd": cost_spread(costs),
            "train/noise_variance": variance,
            "train/planner_failures": float(failures),
        }
        self._loss_sums.zero_()
        self.progress.collected, self.progress.iteration_updates = True, 0

    def _note_eigenvalues(self) -> None:
        dynamics = self.averaged_model.dynamics
        self.eigenvalues.add(len(self._buffer), dynamics.mu.detach(), dynamics.omega.detach())

    def _planned_updates(self) -> int:
        config = self._experience.learning
        windows = self._buffer.windows(config.horizon, config.window_stride)
        return planned_updates(config, self.progress.iteration, windows)

    def _update(self, planned: int) -> None:
        config = self._experience.learning
        batch = self._buffer.sample(
            config.chunks, config.chunk_length, config.horizon, self._sampling, config.window_stride
        )
        losses = self._learner.update(batch, step_size(config, len(self._buffer)), config.horizon)
        self.progress.iteration_updates += 1
        self.progress.updates += 1
        # The means are over the last updates of the iteration, at most as many as a later iteration makes.
        if planned - self.progress.iteration_updates < config.iteration_updates:
            self._loss_sums += torch.stack([getattr(losses, name) for name in LOSS_NAMES])

    def _finish_iteration(self, planned: int, watch: Stopwatch) -> None:
        config = self.config
        self._note_eigenvalues()  # of the last weights, as the losses are, whichever are kept
        growth = float(self.averaged_model.dynamics.mu.detach().max())
        means = (self._loss_sums / min(planned, config.iteration_updates)).tolist()
        losses = dict(zip((f"loss/{name}" for name in LOSS_NAMES), means, strict=True))
        losses |= {n: v * self._experience.cost_unit**2 for n, v in losses.items() if "/cost_" in n}
        final = len(self._buffer) >= config.total_episodes
        count = config.final_evaluation_episodes if final else config.evaluation_episodes
        if config.keep == "best" and final:
            _, episodes = self._evaluate(config.evaluation_episodes, Purpose.EVALUATION)
            self._kept.offer(self.averaged_model, float(episode_costs(episodes).mean()), len(self._buffer))
            self._offer_linear()
            self._kept.restore(self.averaged_model)
        agent, episodes = None, []
        costs, failures = np.full(1, np.nan), 0
        if count:
            agent, episodes = self._evaluate(count, Purpose.FINAL_EVALUATION if final else Purpose.EVALUATION)
            costs = episode_costs(episodes)
            failures = agent.statistics.failures
        if config.keep == "best" and not final:
            self._kept.offer(self.averaged_model, float(costs.mean()), len(self._buffer))
            if self.progress.iteration == 0 or self._kept.linear is not None:
                self._offer_linear()
        kept = self._kept.row if config.keep == "best" else {}
        predicted = self._experience.predicted_costs(episodes, final and self._kept.linear is not None)
        planner, clock = planner_metrics(agent, predicted, self._experience.planner.horizon)
        self.progress.iteration += 1
        self.progress.collected, self.progress.iteration_updates = False, 0
        self.metrics.add(
            {
                "episodes": len(self._buffer),
                "steps": self._experience.steps,
                "updates": self.progress.updates,
                **self._collected,
                **losses,
                "model/largest_growth_rate": growth,
                **evaluation_metrics(costs, count),
                "evaluation/planner_failures": failures,
                **kept,
                **planner,
                **watch.row(),
            },
            clock,
        )

    def _evaluate(self, count: int, purpose: Purpose) -> tuple[VectorAgent, list[Episode]]:
        """Noise-free episodes from start states that are the purpose's own: of the result, or while training."""
        start, final = derive_seed(self.seed, purpose), purpose == Purpose.FINAL_EVALUATION
        linear = self._kept.linear if final else None
        agent = self._controllers.agent(count, start, linear, diagnostics=True)
        return agent, self._noise_free(agent, count, start)

    def _noise_free(self, agent: VectorAgent, count: int, start: int) -> list[Episode]:
        return collect_episodes(self._pool.get(count, self._make_evaluation_envs), agent, start, record=False)

    def _offer_linear(self) -> None:
        """Try EDMDc of the episodes so far with the same planner from the start states of the evaluations."""
        own, config, iteration = self._experience, self._experience.learning, self.progress.iteration
        if not config.warm_start or self._learner.model.frame_encoder is not None:
            return
        count, start = config.evaluation_episodes, derive_seed(self.seed, Purpose.EVALUATION)
        episodes = read_replay(self.folder, iteration + 1)
        alone, seed = 0 if iteration else own.alone, derive_seed(self.seed, Purpose.REFERENCES)
        for linear in fit_candidates(config, episodes, alone, own.linear_action_weight, seed, own.scale):
            agent = self._controllers.agent(count, 0, linear)
            costs = episode_costs(self._noise_free(agent, count, start))
            self._kept.offer_linear(linear, float(costs.mean()), len(self._buffer))

    def _save(self, watch: Stopwatch, name: str = CHECKPOINT_FILE) -> None:
        watch.note(self.progress)
        save_checkpoint(
            self.folder / name,
            {
                "config": asdict(self.config),
                "seed": self.seed,
                **self._learner.state_dict(),
                "sampling": self._sampling.get_state(),
                "noise": self._noise.get_state(),
                "progress": asdict(self.progress),
                "collected": self._collected,
                "loss_sums": self._loss_sums.cpu(),
                "metrics": self.metrics.rows,
                "eigenvalues": self.eigenvalues.rows,
                "kept": self._kept.state_dict(),
                **self._experience.state_dict(),
            },
        )

    def _restore(self, state: dict[str, Any]) -> tuple[list[Row], list[Row]]:
        defaults = asdict(type(self.config)()) | OLDER_SETTINGS
        check_settings(self.folder / CHECKPOINT_FILE, state, asdict(self.config), self.seed, defaults)
        self._learner.load_state_dict(state)
        self._sampling.set_state(state["sampling"])
        self._noise.set_state(state["noise"])
        self._kept = KeptWeights.from_state(state.get("kept", {}))
        self.progress = Progress(**state["progress"])
        collected = self.progress.iteration + self.progress.collected
        self._experience.restore(state, collected)
        self._collected = state["collected"]
        self._loss_sums = state["loss_sums"].to(self.config.device)
        return state["metrics"], state.get("eigenvalues", [])

    def _compare(self) -> dict[str, str]:
        return compare_run(
            lambda: trained_deepkoco(
                self._experience,
                self._controllers.result(self._kept.linear),
                self.metrics.rows,
                self._low,
                self._high,
                self.seed,
            ),
            partial(self._pool.get, make=self._make_evaluation_envs),
            self.config.final_evaluation_episodes,
            self.config.reference_episodes,
            self.seed,
            self.folder,
        )

    def _export(self, comparison: dict[str, str]) -> None:
        training = {
            "seed": self.seed,
            "episodes": len(self._buffer),
            "updates": self.progress.updates,
            **self._experience.decided,
            **self._kept.origin,
            **comparison,
            "package": f"deepkoco {__version__}",
        }
        controller = StoredController(
            *self._controllers.result(self._kept.linear),
            self._low,
            self._high,
            self._task,
            training,
        )
        write_controller(controller, self.folder / MODEL_FOLDER)
