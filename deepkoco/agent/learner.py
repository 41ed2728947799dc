"""Fits the latent model: one gradient step per batch, and the moving average of the weights that acts."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import torch
from torch import Tensor
from torch.optim.swa_utils import get_ema_multi_avg_fn

from deepkoco.agent.action_value import ActionValue
from deepkoco.agent.captured_step import CapturedStep
from deepkoco.agent.config import TrainingConfig, TrainingConfigError
from deepkoco.agent.input_shrinkage import InputShrinkage
from deepkoco.koopman.exported import Array
from deepkoco.koopman.losses import ChunkBatch, Losses, OtherActions, chunk_losses
from deepkoco.koopman.model.model import KoopmanModel
from deepkoco.koopman.model.rollout import ROLLOUTS


class Learner:
    """Model, optimiser and averaged model on one device.

    What acts, is evaluated and is exported is a moving average of the weights: single iterates of Adam swing
    between good and poor swing-ups from one iteration to the next although their losses hardly differ.

    Attributes:
        model: The model that the gradient steps change.
        averaged: The moving average.
    """

    def __init__(
        self,
        observation: int | Sequence[int],
        action_size: int,
        config: TrainingConfig,
        limits: tuple[Array, Array] | None = None,
    ) -> None:
        """Make the model from the global generator of torch; seed it first.

        Args:
            observation: N, or the shape of what the environment gives.
            action_size: M.
            config: Hyper-parameters.
            limits: a_min and a_max (M,) in the units that are learned in; only a value of actions needs them.

        Raises:
            TrainingConfigError: A value of actions is asked for, and frames are observed or no limits are given.
        """
        self._config = config
        # Made on the CPU, so that a seed gives the same weights on every device.
        self.model = KoopmanModel(observation, action_size, config.model).to(config.device)
        self._shrinkage = InputShrinkage(self.model, config.input_shrinkage)
        self.averaged = copy.deepcopy(self.model).requires_grad_(False)
        self._followed, self._own = (tuple(m.parameters()) for m in (self.model, self.averaged))
        self._average = get_ema_multi_avg_fn(config.averaging)
        # Adam's weight decay adds 2 alpha_2 W to the gradient: the L2 term, without an extra graph. The published
        # term excludes biases; alpha_2 is so small that this makes no difference.
        networks = [p for name, p in self.model.named_parameters() if not name.startswith("dynamics.")]
        eigenvalues = {"params": self.model.dynamics.parameters(), "lr": config.eigenvalue_learning_rate}
        self._optimiser = torch.optim.Adam(
            [{"params": networks}, eigenvalues],
            config.learning_rate,
            weight_decay=2.0 * config.weight_penalty,
            fused=True,
        )
        on_gpu = torch.device(config.device).type == "cuda"
        self._captured = CapturedStep(self._step, config.device) if on_gpu else None
        # A captured step reads the learning rates from where they lay when it was captured.
        self._rates = [
            torch.tensor(float(group["lr"]), device=config.device) for group in self._optimiser.param_groups
        ]
        self._place_rates()
        self._value: ActionValue | None = None
        if config.value.discount:
            if limits is None or self.model.frame_encoder is not None:
                raise TrainingConfigError(
                    "value.discount needs states as observations and limits of the actions; give 0 to learn the "
                    "cost of the step"
                )
            self._value = ActionValue(self.model.observation_size, *limits, config.value)

    def update(self, batch: ChunkBatch, step_size: float = 1.0, horizon: int | None = None) -> Losses:
        """Make one gradient step.

        Args:
            batch: The chunks, on any device.
            step_size: Factor on both learning rates.
            horizon: T, steps predicted per window; None takes that of the settings.

        Returns:
            The losses before the step.
        """
        config = self._config
        others = None
        if self._value is not None:
            self._value.update(batch)
            batch, others = self._value.labelled(batch)
        parts = [batch.observations, batch.actions, batch.costs, batch.window_weights]
        if others is not None:
            parts += [others.actions, others.costs]
        key = horizon or config.horizon, None if others is None else others.weight
        rates = [config.learning_rate * step_size, config.eigenvalue_learning_rate * step_size]
        if self._captured is None:
            for group, rate in zip(self._optimiser.param_groups, rates, strict=True):
                group["lr"] = rate
            values = self._step(parts, key)
        else:
            for place, rate in zip(self._rates, rates, strict=True):
                place.fill_(rate)
            values = self._captured(parts, key)
        return Losses(*values.unbind())

    def _step(self, parts: Sequence[Tensor], key: tuple[int, float | None]) -> Tensor:
        """Step on a batch and what is known of other actions; returns the entries of `Losses` (6,)."""
        config, (horizon, weight) = self._config, key
        losses = chunk_losses(
            self.model,
            ChunkBatch(*parts[:4]),
            horizon,
            config.cost_weight,
            ROLLOUTS[config.rollout],
            config.relative_cost,
            None if weight is None else OtherActions(parts[4], parts[5], weight),
        )
        self._optimiser.zero_grad()
        losses.total.backward()
        if config.largest_gradient:
            torch.nn.utils.clip_grad_norm_(self._followed, config.largest_gradient)
        self._optimiser.step()
        self._shrinkage.step(self._optimiser.param_groups[0]["lr"])
        self._average(self._own, self._followed, 0)  # the count is for averages with equal weights
        return torch.stack([getattr(losses, field.name) for field in fields(Losses)]).detach()

    def _place_rates(self) -> None:
        """Have the optimiser read its rates from the device where steps are captured there."""
        for group, rate in zip(self._optimiser.param_groups, self._rates, strict=True):
            group["capturable"] = self._captured is not None
            if self._captured is not None:
                group["lr"] = rate

    def state_dict(self) -> dict[str, Any]:
        """Weights, averaged weights and optimiser."""
        parts = {"model": self.model, "average": self.averaged, "optimiser": self._optimiser}
        if self._value is not None:
            parts["value"] = self._value
        return {name: part.state_dict() for name, part in parts.items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave.

        Args:
            state: The three parts; further entries are left alone.
        """
        self.model.load_state_dict(state["model"])
        self.averaged.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        self._place_rates()
        if self._captured is not None:
            self._captured.forget()
        if self._value is not None:
            self._value.load_state_dict(state["value"])
