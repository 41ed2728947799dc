"""Everything a run has collected: on disk as it was recorded, in memory in the units that the model learns in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deepkoco.agent.buffer import Episode, EpisodeBuffer
from deepkoco.agent.config import TrainingConfig
from deepkoco.agent.discounting import discounted_mean
from deepkoco.agent.first_episodes import calm_rounds, planner_of_linear, task_units
from deepkoco.agent.fitted_settings import fitted, linear_horizon
from deepkoco.agent.replay_files import read_replay, write_replay
from deepkoco.agent.task_scale import TaskScale
from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.planning.config import PlannerConfig


class Experience:
    """The buffer with its units, which the first episodes decide, and the files of the replay.

    Attributes:
        buffer: What is learned from.
        learning: Hyper-parameters as the first episodes call for them, see `fitted`; before them those given.
        scale: Its units; None for those of the environment.
        steps: Steps of the environment.
        noise_floor: Noise of the calmest environment as a share of the boldest's; the first episodes decide.
        alone: How many of the first episodes noise alone has moved.
    """

    def __init__(
        self, folder: Path, config: TrainingConfig, recordings: int, low: Array, high: Array
    ) -> None:
        """Start empty.

        Args:
            folder: Of the run.
            config: Hyper-parameters.
            recordings: d, recordings that an observation is made of.
            low: a_min (M,).
            high: a_max (M,).
        """
        self._folder, self._config, self._limits = folder, config, (low, high)
        self.learning = config
        # With units of the task, the costs to come are in these, and an end counts.
        self.buffer = EpisodeBuffer(recordings, 0.0 if config.scale else config.cost_discount, config.device)
        self.scale: TaskScale | None = None
        self.steps = 0
        self.noise_floor, self.alone = 1.0, 0

    @property
    def cost_unit(self) -> float:
        """Cost of a step that counts as 1 in the buffer."""
        return 1.0 if self.scale is None else self.scale.cost

    def add(self, iteration: int, episodes: list[Episode]) -> None:
        """Take in the episodes of an iteration and write them to their file.

        Args:
            iteration: Its number; the first one decides the units.
            episodes: As they were recorded.

        Raises:
            ReplayError: No episode is as long as a training window.
        """
        if iteration == 0:
            self._fit(episodes)
            if self._config.scale:
                self.scale = task_units(self.learning, episodes, *self._limits)
        self._take(episodes)
        self.buffer.check_windows(self.learning.horizon)
        write_replay(self._folder, iteration, episodes)

    def first(self) -> list[Episode]:
        """The episodes of the first iteration as they were recorded."""
        return read_replay(self._folder, 1)

    def exported(self, model: ExportedModel) -> ExportedModel:
        """A model that learned from the buffer, for observations and costs as they are."""
        return model if self.scale is None else self.scale.fold(model)

    @property
    def planner(self) -> PlannerConfig:
        """Settings of the planner for actions and costs as they are."""
        planner = self.learning.planner
        return planner if self.scale is None else self.scale.planner(planner)

    @property
    def linear_planner(self) -> PlannerConfig:
        """The same for linear models, whose weights are those of costs of single steps."""
        planner = self.learning.planner
        planner = planner if self.scale is None else self.scale.of_steps.planner(planner)
        return planner_of_linear(planner, linear_horizon(self.learning))

    @property
    def linear_action_weight(self) -> float | Array:
        """R of linear models, for actions and costs as they are."""
        weight = float(self.learning.model.action_weight)
        return weight if self.scale is None else self.scale.of_steps.action_weight(weight)

    @property
    def decided(self) -> dict[str, Any]:
        """Settings that the first episodes called for; none where all are those given."""
        own = self.learning
        if own == self._config:
            return {}
        return {
            "horizon": own.horizon,
            "planner_horizon": own.planner.horizon,
            "cost_discount": own.cost_discount,
        }

    @property
    def decision(self) -> str:
        """`decided` as a sentence; empty for nothing."""
        own = self.learning
        if own == self._config:
            return ""
        costs = f" and costs to come with gamma = {own.cost_discount:g}" if own.cost_discount else ""
        return f"the first episodes call for T = {own.horizon}, H = {own.planner.horizon}{costs}"

    def predicted_costs(self, episodes: Sequence[Episode], linear: bool) -> list[Array] | None:
        """What the steps of episodes cost, counted as the model that acted predicts it.

        Args:
            episodes: As they were recorded; their observations may be empty.
            linear: Whether EDMDc acted, and not a network.

        Returns:
            Of each episode the costs of its steps (L,), or the means of those to come: (L,), (L + 1,) behind an end
            that the task made. None for EDMDc beside a network that learns costs to come in the units of the task: some
            candidates learn these, one does not, and a model does not say what it learned.
        """
        scale = self.scale
        if scale is None or not scale.discount:
            gamma = 0.0 if linear else self.buffer.discount or self._config.value.discount
            found = [discounted_mean(episode.costs, gamma) for episode in episodes]
        elif linear:
            return None
        else:
            found = [scale.predicted_costs(episode) for episode in episodes]
        return [costs.double().numpy() for costs in found]

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint needs beside the files of the replay."""
        return {"scale": None if self.scale is None else self.scale.state_dict()}

    def restore(self, state: dict[str, Any], iterations: int) -> None:
        """Read the files of a run that goes on.

        Args:
            state: Of `state_dict`, or that of an earlier release, which had no units of its own.
            iterations: How many have been collected.
        """
        if state.get("scale") is not None:
            self.scale = TaskScale.from_state(state["scale"])
            if not self.scale.discount:
                # An earlier release scaled the costs of steps first and took means in the buffer: it goes on so.
                self.buffer.discount = self._config.cost_discount
        episodes = read_replay(self._folder, iterations)
        if iterations:
            self._fit(episodes)
        self._take(episodes)

    def _fit(self, episodes: list[Episode]) -> None:
        """What follows from the first episodes, those of noise alone first."""
        first = episodes[: self._config.first_episodes]
        self.noise_floor, self.alone, _ = calm_rounds(self._config, first)
        self.learning = fitted(self._config, first[: self.alone])

    def _take(self, episodes: list[Episode]) -> None:
        self.steps += sum(episode.costs.numel() for episode in episodes)
        if self.scale is not None:
            episodes = [self.scale.apply(episode, self.learning.horizon) for episode in episodes]
        self.buffer.add(episodes)
