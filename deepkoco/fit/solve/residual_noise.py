"""Estimate the sensor noise from the residuals of a fit."""

from __future__ import annotations

from deepkoco.fit.data.noise import Noise, residual_noise
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit_types import Fit
from deepkoco.logs.quantum import quantum_of


def sharpen_noise(windows: Windows, fit: Fit) -> tuple[Noise, ...]:
    """Noise of each channel: the smaller one of the estimate from the residuals and that of the windows."""
    result = []
    for c, noise in enumerate(windows.noise):
        valid = windows.valid[:, c].numpy()
        if valid.sum() < 40:
            result.append(noise)
            continue
        residual = (fit.residual[:, c] * noise.sd).numpy()
        quantum = quantum_of(windows.value[:, c][windows.valid[:, c]].numpy())
        result.append(residual_noise(windows.t[:, c].numpy(), residual, valid, quantum, noise))
    return tuple(result)
