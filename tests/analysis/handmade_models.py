"""Latent models made by hand."""

import numpy as np

from deepkoco.koopman.exported import ExportedModel

TIME_STEP = 0.1
MU, OMEGA = np.array([-0.5, 0.2]), np.array([2.0, 5.0])


def linear_model(
    encoder: np.ndarray, factor: np.ndarray, mu=MU, omega=OMEGA, actions: int = 1
) -> ExportedModel:
    """s = encoder (o, a), C constant (r, 2P), R = 0."""
    latents = encoder.shape[0]
    constant = (np.zeros((factor.size, latents)), factor.ravel().astype(float))
    return ExportedModel(
        ((encoder.astype(float), np.zeros(latents)),), (constant,), mu, omega, TIME_STEP, 0.0, actions
    )
