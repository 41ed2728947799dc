"""The trained controller for one robot: NumPy only, no training code."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.koopman.exported_frames import FeatureHistory
from deepkoco.koopman.model_folder import ModelFolderError, read_model_folder
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
        self, model: ExportedModel, planner: PlannerConfig, action_low: Array, action_high: Array
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
        self._history = None if model.frame_encoder is None else FeatureHistory(model.frame_encoder)
        self.reset()

    @property
    def statistics(self) -> PlannerStatistics:
        """Plans made and failed so far."""
        return self._planner.statistics

    def reset(self) -> None:
        """Start a new episode with action zero and no frame seen."""
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
        """What phi takes: the entries of the observation, or the features of the last frames."""
        if self._history is None:
            entries = np.asarray(observation, dtype=np.float64)
            if entries.shape != (self.model.observation_size,):
                raise ObservationError(
                    f"observation has shape {entries.shape}; this model takes ({self.model.observation_size},)"
                )
            return entries
        frame, expected = np.asarray(observation), self._history.frame_shape
        if frame.shape != expected or frame.dtype != np.uint8:
            raise ObservationError(
                f"observation has shape {frame.shape} and type {frame.dtype}; this model takes one frame per "
                f"step, {expected} uint8"
            )
        return self._history.push(frame)


def load_model(folder: str | Path, **planner: Any) -> tuple[ExportedModel, PlannerConfig, Array, Array]:
    """Load what a controller is made of.

    Args:
        folder: Folder of an exported model, or of a finished training run.
        **planner: Settings of `PlannerConfig` to use instead of the stored ones.

    Returns:
        Latent model, planner settings and action limits (M,), (M,).

    Raises:
        ModelFolderError: The folder holds no model this release can read.
        TypeError: An unknown planner setting.
    """
    folder = Path(folder)
    if (folder / "model").is_dir():
        folder = folder / "model"
    model, config = read_model_folder(folder)
    try:
        settings = PlannerConfig(**config["planner"])
        low, high = (np.array(config[name], dtype=np.float64) for name in ("action_low", "action_high"))
    except KeyError as error:
        raise ModelFolderError(f"{folder}: entry {error} of config.json is missing") from error
    except (TypeError, ValueError) as error:
        raise ModelFolderError(f"{folder}: config.json holds no planner of this release: {error}") from error
    if low.shape != (model.action_size,) or high.shape != (model.action_size,):
        raise ModelFolderError(f"{folder}: config.json needs {model.action_size} limits of either kind")
    return model, replace(settings, **planner), low, high


def load_policy(folder: str | Path, **planner: Any) -> KoopmanPolicy:
    """Load a trained controller.

    Args:
        folder: Folder of an exported model, or of a finished training run.
        **planner: Settings of `PlannerConfig` to use instead of the stored ones.

    Returns:
        The controller, with `act(observation) -> action` and `reset()`.

    Raises:
        ModelFolderError: The folder holds no model this release can read.
        TypeError: An unknown planner setting.
    """
    return KoopmanPolicy(*load_model(folder, **planner))
