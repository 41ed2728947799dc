"""Estimate the sensor noise, and the scatter of time stamps, from the residuals of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepkoco.fit.data.noise import Noise, residual_noise, stamp_jitter
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit_types import Fit
from deepkoco.logs.quantum import quantum_of

EVIDENCE = 10.0  # twice the log likelihood ratio from which stamps are taken to scatter
# Share of the way in a window with which a simulation follows any machine at best. A log without noise is from another
# simulation: its integrator, not a cause, makes such a difference.
FIDELITY = 1e-5
LARGEST_SHARE = (
    0.5  # of the time between two samples: stamps that scatter by more would come in another order
)


def sharpen_noise(windows: Windows, fit: Fit) -> tuple[Noise, ...]:
    """Noise of each channel: the smaller one of the estimate from the residuals and that of the windows."""
    sd, result = windows.sample_sd.expand(fit.residual.shape), []
    for c, noise in enumerate(windows.noise):
        valid = windows.valid[:, c].numpy()
        if valid.sum() < 40:
            result.append(noise)
            continue
        residual = (fit.residual[:, c] * sd[:, c]).numpy()
        quantum = quantum_of(windows.value[:, c][windows.valid[:, c]].numpy())
        given = noise._replace(sd=noise.sensor_sd, simulated_sd=0.0)
        found = residual_noise(windows.t[:, c].numpy(), residual, valid, quantum, given)
        result.append(found.with_simulated(noise.simulated_sd**2))
    return tuple(result)


def with_sharp_noise(windows: Windows, fit: Fit) -> Windows:
    """Windows with the noise of each channel and the scatter of each log's time stamps, from the residuals of a fit.

    Scatter of the stamps is noise that grows with the rate of a channel. Without it, a log of one computer clock with
    0.05 ms of scatter shows more than noise wherever the motion is fast.
    """
    noise = sharpen_noise(windows, fit)
    t, value, valid = (x.numpy() for x in (windows.t, windows.value, windows.valid))
    residual = (fit.residual * windows.sample_sd).numpy()
    least = np.array(
        [quantum_of(windows.value[:, c][windows.valid[:, c]].numpy()) for c in range(value.shape[1])]
    ) / np.sqrt(12.0)
    stamps, sds, weights = [], [], []
    for log in range(len(windows.commands)):
        own = windows.log == log
        gaps = np.diff(t[own], axis=-1)[valid[own][..., 1:]] if own.any() else np.zeros(0)
        if len(gaps) == 0:
            stamps.append(0.0)
            continue
        found, sd = stamp_jitter(
            t[own],
            value[own],
            residual[own],
            valid[own],
            least,
            EVIDENCE,
            LARGEST_SHARE * float(np.median(gaps)),
        )
        stamps.append(found)
        sds.append(sd)
        weights.append(valid[own].sum((0, 2)))
    if not any(stamps):
        return replace(windows, noise=_no_finer_than_a_simulation(windows, noise), stamp_sd=())
    # What the stamps explain is no noise of the channel any more.
    share, own_sd = np.array(weights, dtype=float), np.array(sds)
    share[~np.isfinite(own_sd)] = 0.0
    variance = (share * np.nan_to_num(own_sd) ** 2).sum(0) / np.maximum(share.sum(0), 1.0)
    sharper = []
    for c, given in enumerate(noise):
        sd = max(min(given.sd, float(np.sqrt(variance[c]))), float(least[c]), 1e-12)
        sharper.append(_of_size(given, sd) if share[:, c].sum() > 0.0 else given)
    noise = _no_finer_than_a_simulation(windows, sharper)
    return replace(windows, noise=noise, stamp_sd=tuple(stamps))


def _of_size(given: Noise, sd: float) -> Noise:
    """Return noise of another size, of which no more is simulated than before."""
    return given._replace(sd=sd, simulated_sd=min(given.simulated_sd, sd))


def _no_finer_than_a_simulation(windows: Windows, noise: Sequence[Noise]) -> tuple[Noise, ...]:
    """Noise of each channel, at least `FIDELITY` of the way that it typically goes in a window."""
    result = []
    for c, given in enumerate(noise):
        value, valid = windows.value[:, c].numpy(), windows.valid[:, c].numpy()
        shown = valid.any(-1)
        high = np.where(valid, value, -np.inf).max(-1, initial=-np.inf)[shown]
        low = np.where(valid, value, np.inf).min(-1, initial=np.inf)[shown]
        way = float(np.median(high - low)) if shown.any() else 0.0
        result.append(given.with_simulated(max((FIDELITY * way) ** 2 - given.sd**2, 0.0)))
    return tuple(result)
