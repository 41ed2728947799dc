"""A latent model that passes everything on to another one."""

from __future__ import annotations

from dataclasses import dataclass

from deepkoco.koopman.latent_model import Array, LatentDynamics, LatentModel, ObservationHistory


@dataclass(frozen=True)
class WrappedModel:
    """Another model on what a first one sees; a `LatentModel`.

    Attributes:
        model: What is passed on to.
        seen_by: Gives the history of observations: for a model on images it makes features of frames.
    """

    model: LatentModel
    seen_by: LatentModel

    def make_history(self) -> ObservationHistory | None:
        """The history of the model that sees."""
        return self.seen_by.make_history()

    @property
    def observation_size(self) -> int:
        """N."""
        return self.model.observation_size

    @property
    def action_size(self) -> int:
        """M."""
        return self.model.action_size

    @property
    def cost_rank(self) -> int:
        """r."""
        return self.model.cost_rank

    @property
    def action_weight(self) -> float | Array:
        """R."""
        return self.model.action_weight

    @property
    def time_step(self) -> float:
        """Seconds per step."""
        return self.model.time_step

    @property
    def dynamics(self) -> LatentDynamics:
        """Free motion of the latent over one step."""
        return self.model.dynamics

    def linearise(self, observation: Array, action: Array) -> tuple[Array, Array]:
        """Latent, input columns and cost factor; see `LatentModel`."""
        return self.model.linearise(observation, action)

    def factor(self, latent: Array) -> Array:
        """Cost factor; see `LatentModel`."""
        return self.model.factor(latent)
