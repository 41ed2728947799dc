"""From the torch model to the NumPy model."""

from __future__ import annotations

from typing import cast

import numpy as np
from torch import Tensor

from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.koopman.exported_frames import ExportedFrameEncoder
from deepkoco.koopman.model.frame_encoder import FrameEncoder
from deepkoco.koopman.model.mlp import ReluNetwork
from deepkoco.koopman.model.model import KoopmanModel


def export_model(model: KoopmanModel) -> ExportedModel:
    """Copy a model's weights out of torch.

    Args:
        model: The trained model.

    Returns:
        The same function on float64 NumPy arrays.
    """

    def array(tensor: Tensor) -> Array:
        return tensor.detach().cpu().numpy().astype(np.float64)

    def layers(network: ReluNetwork) -> tuple[tuple[Array, Array], ...]:
        return tuple((array(layer.weight), array(layer.bias)) for layer in network.linears)

    def frames(encoder: FrameEncoder) -> ExportedFrameEncoder:
        return ExportedFrameEncoder(
            encoder.frame_shape,
            model.config.frames,
            tuple(encoder.geometry),
            tuple((array(layer.weight), array(cast(Tensor, layer.bias))) for layer in encoder.convolutions),
            (array(encoder.last.weight), array(encoder.last.bias)),
        )

    return ExportedModel(
        layers(model.encoder.network),
        layers(model.cost_factor.network),
        array(model.dynamics.mu),
        array(model.dynamics.omega),
        model.dynamics.time_step,
        model.config.action_weight,
        model.action_size,
        () if model.decoder is None else layers(model.decoder),
        None if model.frame_encoder is None else frames(model.frame_encoder),
    )
