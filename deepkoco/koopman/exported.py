"""A trained latent model as plain NumPy arrays: what runs in a control loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepkoco.koopman.exported_frames import ExportedFrameEncoder, FeatureHistory
from deepkoco.koopman.latent_model import JordanBlocks

Array = NDArray[np.float64]


class NoDecoderError(ValueError):
    """A pseudo-observation was asked of a model without a decoder."""


@dataclass(frozen=True)
class ExportedModel:
    """Encoder, eigenvalues and cost factor for control with NumPy only.

    One batch-1 evaluation in eager torch takes three times as long as these few matrix products.

    Attributes:
        encoder: Weight (out, in) and bias (out,) of each layer of phi.
        cost_factor: The same for psi.
        mu: Growth rates (P,) [1/s].
        omega: Frequencies (P,) [rad/s].
        time_step: Seconds per step.
        action_weight: R of the cost model, one for all actions or one each (M,).
        action_size: M.
        decoder: The layers of phi^-1; empty where B and C are frozen over a rollout.
        frame_encoder: Gives the features of frames, of which an observation then is a stack.
    """

    encoder: tuple[tuple[Array, Array], ...]
    cost_factor: tuple[tuple[Array, Array], ...]
    mu: Array
    omega: Array
    time_step: float
    action_weight: float | Array
    action_size: int
    decoder: tuple[tuple[Array, Array], ...] = ()
    frame_encoder: ExportedFrameEncoder | None = None

    @property
    def observation_size(self) -> int:
        """N, entries of an observation as the encoder phi takes it."""
        return self.encoder[0][0].shape[1] - self.action_size

    def make_history(self) -> FeatureHistory | None:
        """The history of frames of one environment; None for a model on states."""
        return None if self.frame_encoder is None else FeatureHistory(self.frame_encoder)

    @property
    def cost_rank(self) -> int:
        """r, rows of the cost factor."""
        return self.cost_factor[-1][1].size // (2 * self.mu.size)

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Discrete-time eigenvalues e^{(mu + i omega) dt} (P,), one of each conjugate pair."""
        return np.exp((self.mu + 1j * self.omega) * self.time_step)

    @property
    def dynamics(self) -> JordanBlocks:
        """Free motion of the latent over one step."""
        return JordanBlocks(self.eigenvalues)

    def linearise(self, observation: Array, action: Array) -> tuple[Array, Array]:
        """Latent, input matrix and cost factor at one point or a batch of points.

        Args:
            observation: (..., N).
            action: (..., M).

        Returns:
            Rows (..., 1 + M, 2P): the latent s, then the M columns of B as rows; and the cost factor C
            (..., r, 2P).

        Source: DeepKoCo, Eq. 5.6-5.8.
        """
        x = np.concatenate((observation, action), axis=-1)
        # Value and derivatives go through the layers as rows of one matrix: half the calls.
        weight, bias = self.encoder[0]
        rows = np.empty((*x.shape[:-1], 1 + self.action_size, weight.shape[0]))
        rows[..., 0, :] = x @ weight.T
        rows[..., 1:, :] = weight.T[-self.action_size :]
        rows[..., 0, :] += bias
        for weight, bias in self.encoder[1:]:
            rows *= rows[..., :1, :] > 0
            rows = rows @ weight.T
            rows[..., 0, :] += bias
        return rows, self.factor(rows[..., 0, :])

    def factor(self, latent: Array) -> Array:
        """The cost factor C_s = psi(s).

        Args:
            latent: (..., 2P).

        Returns:
            C (..., r, 2P).
        """
        factor = _evaluate(self.cost_factor, latent)
        return factor.reshape(*factor.shape[:-1], -1, 2 * self.mu.size)

    def decode(self, latent: Array) -> Array:
        """The pseudo-observation phi^-1(s), at which B can be evaluated anew.

        It is trained to give good B and nothing else, so it need not look like an observation.

        Args:
            latent: (..., 2P).

        Returns:
            Pseudo-observation (..., N).

        Raises:
            NoDecoderError: The model has none.

        Source: DeepKoCo, Eq. 5.10.
        """
        if not self.decoder:
            raise NoDecoderError(
                "this model has no decoder; train one with agent.rollout=updated agent.model.decoder_hidden=[90,90]"
            )
        return _evaluate(self.decoder, latent)

    def linearise_along(self, latents: Array, actions: Array) -> tuple[Array, Array]:
        """B and C at latents of a plan instead of at an observation.

        Args:
            latents: Predicted s_k (..., 2P).
            actions: Planned a_k (..., M).

        Returns:
            The M columns of B_k as rows (..., M, 2P), at the pseudo-observations, and C_k (..., r, 2P).

        Raises:
            NoDecoderError: The model has no decoder.

        Source: DeepKoCo, Eq. 5.7, 5.8 and 5.10.
        """
        rows, _ = self.linearise(self.decode(latents), actions)
        return rows[..., 1:, :], self.factor(latents)


def _evaluate(layers: tuple[tuple[Array, Array], ...], x: Array) -> Array:
    """A ReLU network at x (..., inputs)."""
    for weight, bias in layers[:-1]:
        x = np.maximum(x @ weight.T + bias, 0.0)
    weight, bias = layers[-1]
    return x @ weight.T + bias
