"""What a controller of one's own needs beside s, B and C: as plain arrays by name."""

from __future__ import annotations

import numpy as np

from deepkoco.interchange.loaded_model import LoadedModel
from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel


def controller_constants(model: LoadedModel) -> dict[str, Array]:
    """Dynamics, weights and limits.

    Args:
        model: The model.

    Returns:
        `Lambda` (n, n), `time_step` [s], `action_weight` R, `increment_weight` R~, `horizon` H, `action_low` and
        `action_high` (M,).
    """
    return {
        "Lambda": model.Lambda,
        "time_step": np.array(model.time_step),
        "action_weight": np.array(model.action_weight),
        "increment_weight": np.array(model.planner.increment_weights),
        "horizon": np.array(float(model.planner.horizon)),
        "action_low": model.action_low,
        "action_high": model.action_high,
    }


def network_arrays(model: LoadedModel) -> dict[str, Array]:
    """Weights of the functions that give s, B and C, by names that MATLAB takes too.

    Args:
        model: The model.

    Returns:
        Of a trained model `encoder_W0`, `encoder_b0`, ... (outputs, inputs), and the same of `cost_factor`,
        `decoder`, `frame_encoder`; of a lifted linear one `A`, `B`, `cost_factor`, `cost_offset` and the numbers of
        its lifting, `lifting_NAME`. Names, of its kind, kernel or activation, are not among them.
    """
    latent_model = model.latent_model
    if isinstance(latent_model, ExportedModel):
        networks = {
            "encoder": latent_model.encoder,
            "cost_factor": latent_model.cost_factor,
            "decoder": latent_model.decoder,
        }
        if latent_model.frame_encoder is not None:
            frames = latent_model.frame_encoder
            networks["frame_encoder"] = (*frames.convolutions, frames.last)
        return {
            f"{name}_{kind}{i}": array
            for name, layers in networks.items()
            for i, layer in enumerate(layers)
            for kind, array in zip("Wb", layer, strict=True)
        }
    assert isinstance(latent_model, LiftedLinearModel)
    arrays = {
        "A": latent_model.transition,
        "B": latent_model.inputs,
        "cost_factor": latent_model.cost.factor,
        "cost_offset": latent_model.cost.offset,
    }
    for name, value in vars(latent_model.lifting).items():
        if isinstance(value, np.ndarray | int | float):
            arrays[f"lifting_{name}"] = np.asarray(value, np.float64)
        elif isinstance(value, tuple):
            for i, (weight, bias) in enumerate(value):
                arrays[f"lifting_W{i}"], arrays[f"lifting_b{i}"] = weight, bias
    return arrays
