"""The trained controller for one robot: NumPy only, no training code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deepkoco.agent.stored_controller import read_controller
from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.koopman.files.model_folder import ModelFolderError
from deepkoco.koopman.latent_model import LatentModel
from deepkoco.planning.config import PlannerConfig
from deepkoco.planning.methods import make_planner
from deepkoco.planning.statistics import PlannerStatistics


class ObservationError(ValueError):
    """An observation has the wrong number of entries, or a frame the wrong shape or type."""


class KoopmanPolicy:
    """Noise-free DeepKoCo control, one call of `act` per control step.

    `act(o_k)` returns the action a_k that was decided one step earlier and decides a_{k+1}, as in training.
    It never raises for numbers: where a plan cannot be made it holds the last one and counts that in
    `statistics`.
    """

    def __init__(
        self, model: LatentModel, planner: PlannerConfig, action_low: Array, action_high: Array
    ) -> None:
        """Set up the controller.

        Args:
            model: The latent model.
            planner: Settings of the planner.
            action_low: a_min (M,).
            action_high: a_max (M,).
        """
        self.model = model
        self._low, self._high = np.asarray(action_low, np.float64), np.asarray(action_high, np.float64)
        self._planner = make_planner(model, planner, self._low, self._high)
        self._history = model.make_history()
        self.reset()

    @property
    def statistics(self) -> PlannerStatistics:
        """Plans made and failed so far."""
        return self._planner.statistics

    def reset(self) -> None:
        """Start a new episode with action zero and nothing seen."""
        self._next = np.clip(np.zeros_like(self._low), self._low, self._high)
        self._planner.reset()
        if self._history is not None:
            self._history.reset()

    def act(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Control one step.

        Args:
            observation: o_k (N,); for a model on images the frame of this step, uint8 (H, W, 3).

        Returns:
            a_k (M,).

        Raises:
            ObservationError: The observation does not have N entries, or it is not such a frame.
        """
        action = self._next
        rows, factor = self.model.linearise(self._observe(observation), action)
        self._next = action + self._planner.plan(rows, factor, action)
        return action.astype(np.float32)

    def _observe(self, observation: ArrayLike) -> Array:
        """What the model takes: the entries of the observation, or the history that it makes of them."""
        if self._history is None:
            entries = np.asarray(observation, dtype=np.float64)
            if entries.shape != (self.model.observation_size,):
                raise ObservationError(
                    f"observation has shape {entries.shape}; this model takes ({self.model.observation_size},)"
                )
            return entries
        shape, kind = self._history.observation_shape, self._history.observation_type
        given = np.asarray(observation)
        if given.shape != shape or not np.can_cast(given.dtype, kind):
            raise ObservationError(
                f"observation has shape {given.shape} and type {given.dtype}; this model takes {shape} "
                f"{np.dtype(kind)}, one per step"
            )
        return self._history.push(given.astype(kind, copy=False))


def load_model(folder: str | Path, **planner: Any) -> tuple[LatentModel, PlannerConfig, Array, Array]:
    """Load what the controller of a trained model is made of; `deepkoco.load` also takes imported models.

    Args:
        folder: Folder of an exported model, or of a finished training run.
        **planner: Settings of `PlannerConfig` to use instead of the stored ones.

    Returns:
        Latent model, planner settings and action limits (M,), (M,).

    Raises:
        ModelFolderError: The folder holds no trained model this release can read.
        TypeError: An unknown planner setting.
    """
    stored = read_controller(folder, planner)
    if not isinstance(stored.model, ExportedModel) and "kept" not in stored.training:
        raise ModelFolderError(
            f"{folder}: holds an imported model, not a trained one; load it with deepkoco.load"
        )
    return stored.model, stored.planner, stored.action_low, stored.action_high


def load_policy(folder: str | Path, **planner: Any) -> KoopmanPolicy:
    """Load a controller.

    Args:
        folder: Folder of an exported model, or of a finished training run.
        **planner: Settings of `PlannerConfig` to use instead of the stored ones.

    Returns:
        The controller, with `act(observation) -> action` and `reset()`.

    Raises:
        ModelFolderError: The folder holds no model this release can read.
        TypeError: An unknown planner setting.
    """
    stored = read_controller(folder, planner)
    return KoopmanPolicy(stored.model, stored.planner, stored.action_low, stored.action_high)
