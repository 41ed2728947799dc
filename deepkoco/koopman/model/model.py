"""The latent model: encoder, Jordan dynamics and cost factor, with its size and units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from deepkoco.koopman.exported import NoDecoderError
from deepkoco.koopman.jordan import JordanDynamics
from deepkoco.koopman.model.cost import CostFactor
from deepkoco.koopman.model.encoder import Encoder
from deepkoco.koopman.model.frame_encoder import FrameEncoder, stack_features
from deepkoco.koopman.model.mlp import ReluNetwork


@dataclass
class ModelConfig:
    """Sizes of the latent model."""

    pairs: int = 10
    """P, complex eigenvalue pairs; the latent has 2P components."""
    time_step: float = 0.05
    """Seconds between two decisions of the agent."""
    encoder_hidden: tuple[int, ...] = (90, 90)
    """Widths of the hidden layers of phi."""
    cost_hidden: tuple[int, ...] = (70, 70)
    """Widths of the hidden layers of psi."""
    cost_rank: int = 1
    """r, rows of the cost factor C."""
    action_weight: float = 0.001
    """R, weight of a squared action in the predicted cost."""
    decoder_hidden: tuple[int, ...] = ()
    """Widths of the hidden layers of phi^-1; empty for no decoder, which only updated rollouts use."""
    sign_initialisation: bool = True
    """Start with output biases that give y = C s one sign everywhere; off: PyTorch's default biases."""
    stop_gradients: tuple[str, ...] = ()
    """Paths that training does not differentiate: "B" (into the input matrix), "C" (into the input of psi)."""
    frames: int = 3
    """d, frames of an observation, where frames are observed."""
    frame_features: int = 16
    """F, features of a frame."""
    frame_channels: tuple[int, ...] = (8, 16, 32)
    """Channels of the convolutions that each frame goes through."""


class KoopmanModel(nn.Module):
    r"""A cost-predictive Koopman latent model.

    $s = \varphi(o, a)$, $s_{k+1} = \Lambda s_k + B \Delta a_k$, $a_{k+1} = a_k + \Delta a_k$,
    $\hat c = |C s|^2 + a^\top R a$, with $B = \partial\varphi/\partial a$ and $C = \psi(s)$ at the present
    state. With B frozen over a rollout a decoder would enter no loss, so there is none then; where B and C are
    evaluated anew at predicted latents it gives the pseudo-observations $\varphi^{-1}(s)$ for that.

    Where the environment gives frames, o is the stack of the features of the last d frames. The frame encoder
    comes before $\varphi$, so B never passes through it.

    Source: DeepKoCo, Eq. 5.4-5.11.
    """

    def __init__(self, observation: int | Sequence[int], action_size: int, config: ModelConfig) -> None:
        """Make the networks from the global generator of torch; seed it first.

        Args:
            observation: N, or the shape of what the environment gives: (N,), or (H, W, 3) for frames.
            action_size: M.
            config: Sizes.

        Raises:
            FrameShapeError: Frames are too small.
        """
        super().__init__()
        self.config = config
        shape = (observation,) if isinstance(observation, int) else tuple(observation)
        observation_size = shape[0] if len(shape) == 1 else config.frames * config.frame_features
        self.frame_encoder: FrameEncoder | None = None
        if len(shape) > 1:
            self.frame_encoder = FrameEncoder(shape, config.frame_channels, config.frame_features)
        self.observation_size = observation_size
        self.action_size = action_size
        self.encoder = Encoder(observation_size, action_size, config.pairs, config.encoder_hidden)
        self.dynamics = JordanDynamics(config.pairs, config.time_step)
        self.cost_factor = CostFactor(config.pairs, config.cost_hidden, config.cost_rank)
        if config.sign_initialisation:
            self.encoder.bias_sign()
            self.cost_factor.bias_sign()
        self.decoder: ReluNetwork | None = None
        if config.decoder_hidden:
            self.decoder = ReluNetwork(2 * config.pairs, config.decoder_hidden, observation_size)

    def encoder_and_factors(
        self, observations: Tensor, actions: Tensor, starts: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Encode sequences and linearise at their first steps only.

        Args:
            observations: (G, L, N), or frames from d - 1 steps before the first one, (G, L + d - 1, H, W, 3).
            actions: (G, L, M).
            starts: Number of leading steps at which B and C are wanted.

        Returns:
            Latents (G, L, 2P), input matrices (G, starts, 2P, M) and cost factors (G, starts, r, 2P).
        """
        if self.frame_encoder is not None:
            observations = stack_features(self.frame_encoder(observations), self.config.frames)
        latent, input_matrix, factor = self.linearise(observations[:, :starts], actions[:, :starts])
        rest = self.encoder(observations[:, starts:], actions[:, starts:])
        return torch.cat((latent, rest), 1), input_matrix, factor

    def linearise(self, observation: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Everything the planner needs at one point.

        Args:
            observation: (..., N).
            action: (..., M).

        Returns:
            Latent s (..., 2P), input matrix B (..., 2P, M) and cost factor C (..., r, 2P).
        """
        latent, input_matrix = self.encoder.with_input_matrix(observation, action)
        return latent, self._maybe_stopped("B", input_matrix), self.factor(latent)

    def factor(self, latent: Tensor) -> Tensor:
        """The cost factor C_s = psi(s).

        Args:
            latent: (..., 2P).

        Returns:
            C (..., r, 2P).
        """
        return self.cost_factor(self._maybe_stopped("C", latent))

    def linearise_latent(self, latent: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Decode a predicted latent and linearise at its pseudo-observation.

        Args:
            latent: (..., 2P).
            action: (..., M).

        Returns:
            The latent encoded again (..., 2P) and B (..., 2P, M).

        Raises:
            NoDecoderError: The model has no decoder.

        Source: DeepKoCo, Eq. 5.7 and 5.10.
        """
        if self.decoder is None:
            raise NoDecoderError("this model has no decoder; give agent.model.decoder_hidden=[90,90]")
        encoded, input_matrix = self.encoder.with_input_matrix(self.decoder(latent), action)
        return encoded, self._maybe_stopped("B", input_matrix)

    def _maybe_stopped(self, path: str, tensor: Tensor) -> Tensor:
        return tensor.detach() if path in self.config.stop_gradients else tensor
