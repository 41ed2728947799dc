"""`deepkoco.load`: a latent model to control with, or to take apart; NumPy only, no training code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deepkoco.agent.policy import KoopmanPolicy, ObservationError
from deepkoco.agent.stored_controller import StoredController, read_controller, write_controller
from deepkoco.interchange.hub import PREFIX, HubError, fetch, parse_hub_name
from deepkoco.koopman.exported import Array
from deepkoco.koopman.latent_model import LatentModel
from deepkoco.planning.config import PlannerConfig
from deepkoco.planning.statistics import PlannerStatistics


@dataclass(frozen=True)
class Prediction:
    """What a model expects over T steps; entry 0 is the present.

    Attributes:
        latents: s_0 .. s_T (T + 1, n).
        actions: a_0 .. a_T (T + 1, M).
        costs: Predicted costs of steps 0 .. T (T + 1,).
    """

    latents: Array
    actions: Array
    costs: Array


class LoadedModel:
    r"""A latent model with its planner.

    $s = \varphi(o, a)$, $s_{k+1} = \Lambda s_k + B \Delta a_k$, $a_{k+1} = a_k + \Delta a_k$,
    $\hat c = |C s|^2 + R a^\top a$, with B and C taken at the present point.

    n is the number of latent entries: 2P for P eigenvalue pairs. Where the model sees frames or a history, an
    `observation` of `act` is that of one step; everywhere else it is the last d ones, oldest first (..., d, N).

    Source: DeepKoCo, Eq. 5.4-5.8 and 5.16.
    """

    def __init__(self, stored: StoredController) -> None:
        """Set up the controller.

        Args:
            stored: Model, planner's settings, limits, and what they are for.
        """
        self._stored = stored
        self._policy = KoopmanPolicy(stored.model, stored.planner, stored.action_low, stored.action_high)

    def __repr__(self) -> str:
        name = self.task.get("name") or "unnamed task"
        sizes = f"{self.Lambda.shape[0]} latents, {len(self.action_low)} actions"
        return f"LoadedModel({name}, {sizes}, {self.time_step:g} s per step)"

    def act(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Control one step.

        Args:
            observation: o_k (N,); for a model on images the frame of this step, uint8 (H, W, 3).

        Returns:
            a_k (M,), decided one step earlier; a_{k+1} is decided now.

        Raises:
            ObservationError: The observation does not fit the model.
        """
        return self._policy.act(observation)

    def reset(self) -> None:
        """Start a new episode: action zero, nothing seen."""
        self._policy.reset()

    @property
    def statistics(self) -> PlannerStatistics:
        """Plans made and failed so far."""
        return self._policy.statistics

    @property
    def latent_model(self) -> LatentModel:
        """What the planner plans on."""
        return self._stored.model

    @property
    def planner(self) -> PlannerConfig:
        """Settings of the planner."""
        return self._stored.planner

    @property
    def action_low(self) -> Array:
        """a_min (M,)."""
        return self._stored.action_low.copy()

    @property
    def action_high(self) -> Array:
        """a_max (M,)."""
        return self._stored.action_high.copy()

    @property
    def task(self) -> Mapping[str, Any]:
        """What it controls: name, id, kwargs, distractors, observation, action_units; as far as known."""
        return dict(self._stored.task)

    @property
    def training(self) -> Mapping[str, Any]:
        """Where it comes from: seed, episodes, package; as far as known."""
        return dict(self._stored.training)

    @property
    def time_step(self) -> float:
        """Seconds per step."""
        return self.latent_model.time_step

    @property
    def action_weight(self) -> float | Array:
        """R of the predicted cost."""
        return self.latent_model.action_weight

    @property
    def Lambda(self) -> Array:
        """Transition matrix of one step (n, n)."""
        return self.latent_model.dynamics.matrix

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Eigenvalues of Lambda (n,), per step, conjugates included."""
        return np.linalg.eigvals(self.Lambda).astype(np.complex128)

    def encode(self, observation: ArrayLike, action: ArrayLike) -> Array:
        """The latent phi(o, a).

        Args:
            observation: (..., N); (..., d, H, W, 3) uint8 for images, (..., d, N) for delays, oldest first.
            action: (..., M), the action applied while the observation holds.

        Returns:
            s (..., n).

        Raises:
            ObservationError: Observation or action do not fit the model.
        """
        return self._linearise(observation, action)[0][..., 0, :]

    def B(self, observation: ArrayLike, action: ArrayLike) -> Array:
        """Input matrix, the derivative of phi by the action.

        Args:
            observation: As for `encode`.
            action: (..., M).

        Returns:
            B (..., n, M).

        Raises:
            ObservationError: Observation or action do not fit the model.
        """
        return self._linearise(observation, action)[0][..., 1:, :].swapaxes(-1, -2)

    def C(self, latent: ArrayLike) -> Array:
        """Cost factor psi(s).

        Args:
            latent: (..., n).

        Returns:
            C (..., r, n).

        Raises:
            ObservationError: The latent does not have n entries.
        """
        entries, size = np.asarray(latent, np.float64), self.latent_model.dynamics.latent_size
        if entries.shape[-1:] != (size,):
            raise ObservationError(f"latent has shape {entries.shape}; this model has (..., {size})")
        return self.latent_model.factor(entries)

    def rollout(self, observation: ArrayLike, action: ArrayLike, increments: ArrayLike) -> Prediction:
        """Predict with B and C of the present point, as the planner does.

        Args:
            observation: As for `encode`, without leading axes.
            action: a_0 (M,).
            increments: da_0 .. da_{T-1} (T, M).

        Returns:
            Latents, actions and costs of steps 0 .. T.

        Raises:
            ObservationError: Observation, action or increments do not fit the model.
        """
        rows, factor = self._linearise(observation, action)
        steps = np.asarray(increments, np.float64)
        if rows.ndim != 2 or steps.ndim != 2 or steps.shape[1] != len(rows) - 1:
            raise ObservationError(
                f"increments have shape {steps.shape}; give (T, {rows.shape[-2] - 1}) and one observation"
            )
        dynamics = self.latent_model.dynamics
        latents = [rows[0]]
        for step in steps:
            latents.append(dynamics.advance(latents[-1]) + step @ rows[1:])
        actions = np.asarray(action, np.float64) + np.vstack((np.zeros((1, steps.shape[1])), steps)).cumsum(0)
        stacked = np.array(latents)
        costs = np.square(stacked @ factor.T).sum(-1) + (self.action_weight * np.square(actions)).sum(-1)
        return Prediction(stacked, actions, costs)

    def save(self, folder: str | Path) -> None:
        """Write the model into a new folder that `load` reads, all or nothing.

        Args:
            folder: Must not exist.

        Raises:
            ModelFolderError: The folder exists.
            LiftingError: The model holds a function, which no file can hold.
        """
        write_controller(self._stored, Path(folder))

    def _linearise(self, observation: ArrayLike, action: ArrayLike) -> tuple[Array, Array]:
        model = self.latent_model
        action = np.asarray(action, np.float64)
        history = model.make_history()
        if history is None:
            entries = np.asarray(observation, np.float64)
        else:
            given, shape = np.asarray(observation), history.observation_shape
            kind, lead = history.observation_type, given.ndim - len(shape) - 1
            fits = lead >= 0 and given.shape[lead + 1 :] == shape and given.shape[lead] > 0
            if not fits or not np.can_cast(given.dtype, kind):
                raise ObservationError(
                    f"observation has shape {given.shape} and type {given.dtype}; "
                    f"give the last ones, (d, *{shape}) {np.dtype(kind)}"
                )
            for step in np.moveaxis(given, lead, 0):
                entries = history.push(step.astype(kind, copy=False))
        expected = (model.observation_size,), (model.action_size,)
        if (entries.shape[-1:], action.shape[-1:]) != expected or entries.shape[:-1] != action.shape[:-1]:
            raise ObservationError(
                f"observation {entries.shape} and action {action.shape}; "
                f"this model takes (..., {model.observation_size}) and (..., {model.action_size})"
            )
        return model.linearise(entries, action)


def load(path: str | Path, **planner: Any) -> LoadedModel:
    """Load a model. Nothing in its files is run.

    Args:
        path: Folder of a model or of a finished training run, or a repository of the Hugging Face hub,
            "ORG/NAME" or "hf://ORG/NAME", with "@REVISION" behind it for other than the newest.
        **planner: Settings of `deepkoco.planning.PlannerConfig` to use instead of the stored ones.

    Returns:
        The model.

    Raises:
        ModelFolderError: The folder holds no model this release can read.
        HubError: There is no such folder, and the hub does not give one of that name.
        TypeError: An unknown planner setting.
    """
    name = str(path)
    if not name.startswith(PREFIX) and (Path(path).is_dir() or isinstance(path, Path)):
        return LoadedModel(read_controller(path, planner))
    repository = parse_hub_name(name)
    if repository is None:
        raise HubError(f"{name}: no such folder, and no ORG/NAME or hf://ORG/NAME[@REVISION] of the hub")
    folder, root = fetch(repository)
    return LoadedModel(read_controller(folder, planner, root))
