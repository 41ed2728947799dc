"""The Kalman filter of a linear system in continuous time, over steps of any length.

    dx = (A x + B u) dt + dw,  E[dw dw^T] = W dt         y_i = C_i x + v_i,  E[v_i^2] = r_i^2

Over a step h with a constant command the belief N(m, P) becomes

    m' = F m + G u,  P' = F P F^T + Q
    F = exp(A h),  G = integral of exp(A s) B ds,  Q = integral of exp(A s) W exp(A s)^T ds,  s from 0 to h.

All three are power series in h, with as many terms as the longest step needs for rounding. They take no decomposition
of a matrix, so that a node which filters can be compiled, and h may differ between the environments of a batch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

MOST_TERMS = 40
NEGLIGIBLE = 1e-15  # share of what is left out


class LinearModelError(ValueError):
    """Matrices do not make a model, or a step is too long for it."""


class Gaussian(NamedTuple):
    """A belief: mean (B, S) and covariance (B, S, S)."""

    mean: Tensor
    covariance: Tensor


class Transition(NamedTuple):
    """F (B, S, S), G (B, S, M) and Q (B, S, S) of a step."""

    state: Tensor
    command: Tensor
    noise: Tensor


class LinearModel:
    """A linear system and its sensors.

    Args:
        dynamics: A (S, S) [1/s].
        command: B (S, M).
        sensor: C (N, S).
        noise_density: W, or its diagonal (S,): the state's unit squared per second.
        noise_sd: r (N,), standard deviation of each sensor, above 0.
        longest_step: Longest h [s].

    Raises:
        LinearModelError: Shapes do not fit, a standard deviation is not above 0, or the longest step is so long
            that the series does not converge.
    """

    def __init__(
        self,
        dynamics: ArrayLike,
        command: ArrayLike,
        sensor: ArrayLike,
        noise_density: ArrayLike,
        noise_sd: ArrayLike,
        longest_step: float,
    ) -> None:
        a, b, c = (np.asarray(matrix, dtype=np.float64) for matrix in (dynamics, command, sensor))
        w, r = np.asarray(noise_density, dtype=np.float64), np.asarray(noise_sd, dtype=np.float64)
        w = np.diag(w) if w.ndim == 1 else w
        size = len(a)
        shapes = {"dynamics": (a, (size, size)), "command": (b, (size, b.shape[-1])), "sensor": (c, (len(c), size)),
                  "noise_density": (w, (size, size)), "noise_sd": (r, (len(c),))}  # fmt: skip
        for name, (matrix, shape) in shapes.items():
            if matrix.shape != shape:
                raise LinearModelError(f"{name} has shape {matrix.shape}, not {shape}")
        if not (r > 0.0).all():
            raise LinearModelError(f"noise_sd = {r.tolist()}: give values above 0")
        self.sensor, self.noise_sd = torch.from_numpy(c), tuple(r.tolist())
        self.longest_step = longest_step
        powers = _powers(a, longest_step)
        self._state = torch.from_numpy(np.stack(powers))
        self._command = torch.from_numpy(np.stack([p @ b / (k + 1) for k, p in enumerate(powers)]))
        # The s^k of exp(A s) W exp(A s)^T, by the sum of A^i W (A^T)^j / (i! j!) over i + j = k.
        terms = 2 * len(powers) - 1
        spread = [
            sum(powers[i] @ w @ powers[k - i].T for i in range(len(powers)) if 0 <= k - i < len(powers))
            for k in range(terms)
        ]
        self._noise = torch.from_numpy(np.stack([s / (k + 1) for k, s in enumerate(spread)]))

    def transition(self, step: Tensor) -> Transition:
        """What a step (B,) [s], at most the longest one, does."""
        return Transition(
            _polynomial(self._state, step),
            step[:, None, None] * _polynomial(self._command, step),
            step[:, None, None] * _polynomial(self._noise, step),
        )


def predict(belief: Gaussian, command: Tensor, step: Transition) -> Gaussian:
    """The belief after a step under a constant command (B, M)."""
    mean = (step.state @ belief.mean[..., None])[..., 0] + (step.command @ command[..., None])[..., 0]
    covariance = step.state @ belief.covariance @ step.state.mT + step.noise
    return Gaussian(mean, covariance)


def update(belief: Gaussian, model: LinearModel, measurement: Tensor) -> Gaussian:
    """The belief after a measurement (B, N), one sensor after the other (their noises are independent).

    The covariance is updated in Joseph's form, P' = (I - K C) P (I - K C)^T + K r^2 K^T, which stays positive.
    """
    mean, covariance = belief
    for index, spread in enumerate(model.noise_sd):
        row = model.sensor[index].to(mean.device)
        across = covariance @ row  # P C^T (B, S)
        gain = across / ((across @ row) + spread**2)[:, None]
        mean = mean + gain * (measurement[:, index] - mean @ row)[:, None]
        # (I - K C) P (I - K C)^T written out: no product with an identity.
        left = covariance - gain[:, :, None] * across[:, None, :]
        right = left @ row
        covariance = (
            left - right[:, :, None] * gain[:, None, :] + spread**2 * gain[:, :, None] * gain[:, None, :]
        )
    return Gaussian(mean, covariance)


def _powers(a: np.ndarray, longest: float) -> list[np.ndarray]:
    """A^k / k! from k = 0 on, until the rest is negligible over the longest step."""
    norm = float(np.linalg.norm(a, 2)) * longest
    powers, left = [np.eye(len(a))], norm
    while left > NEGLIGIBLE:
        count = len(powers)
        if count == MOST_TERMS:
            raise LinearModelError(
                f"a step of {longest:g} s is {norm:.3g} time constants of the model, too long for its series; "
                "take shorter steps"
            )
        powers.append(powers[-1] @ a / count)
        left = math.exp(norm) * norm ** (count + 1) / math.factorial(count + 1)
    return powers


def _polynomial(coefficients: Tensor, step: Tensor) -> Tensor:
    """Sum of coefficients[k] step^k, (B, ...), by Horner's rule."""
    own = coefficients.to(step.device)
    h = step[:, None, None]
    total = own[-1].expand(len(step), *own.shape[1:])
    for coefficient in reversed(own[:-1].unbind(0)):
        total = coefficient + h * total
    return total
