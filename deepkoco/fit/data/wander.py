"""How noise of logged commands makes a simulation wander from a log, and how residuals are rid of it.

A log of a measured current or force holds the noise of its sensor. A simulation integrates it, so that it wanders from
the unit by far more than a good encoder shows, whatever its parameters are: 2 N of noise move a slide of 20 kg by
2 mm within a second. Errors of neighbouring samples are then nearly the same, and least squares with independent errors
is neither efficient nor calibrated. With noise e of the sensors and G w of the commands, the residuals have the
covariance I + G G', in noise variances; whitened by its inverse square root, they are independent again. The symmetric
root changes no sample more than it must. What the log itself tells of the noise is taken out of the commands
(:mod:`.likely_commands`).

Source: Aitken, On least squares and linear combination of observations (1935).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from torch import Tensor


class Whitening(NamedTuple):
    """Transformations of residuals in noise standard deviations: I + G S G' in each window.

    Attributes:
        moves: (W, NM, K) moves G of the measurements by one standard deviation of each piece of noise.
        out: (W, K, K) S of the inverse square root of I + G G'.
        back: (W, K, K) S of its square root.
        hidden: (W, NM, K) H with (I + G G')^-1 = I - H H': what of a measurement its window no longer tells.
    """

    moves: Tensor
    out: Tensor
    back: Tensor
    hidden: Tensor

    def whitened(self, residual: Tensor) -> Tensor:
        """Return residuals (..., W, N, M) without their wandering."""
        return self._applied(residual, -self.out)

    def as_measured(self, whitened: Tensor) -> Tensor:
        """Return the residuals (..., W, N, M) from which whitened ones were made."""
        return self._applied(whitened, self.back)

    def take(self, index: Tensor) -> Whitening:
        """Select windows."""
        return Whitening(*(each[index] for each in self))

    def _applied(self, residual: Tensor, size: Tensor) -> Tensor:
        columns = residual.flatten(-2).reshape(-1, *self.moves.shape[:2]).permute(1, 2, 0)  # (W, NM, L)
        moved = self.moves @ (size @ (self.moves.mT @ columns))
        return residual + moved.permute(2, 0, 1).reshape(residual.shape)


@dataclass(frozen=True, eq=False)
class Wander:
    """Noise of the commands of W windows, and what it does to their measurements.

    Attributes:
        sd: Standard deviation of the noise of each command, in its unit.
        moves: (W, N, M, K) moves of the measurements by one standard deviation of each of K pieces of noise, in the
            channels' units.
        logged: Square root of the covariance of the noise of each command with the logged command, in its unit, see
            :mod:`.likely_commands`.
    """

    sd: tuple[float, ...]
    moves: Tensor
    logged: tuple[float, ...] = ()
    _made: dict[bytes, Whitening] = field(default_factory=dict, init=False, repr=False)

    def whitening(self, weight: Tensor) -> Whitening:
        """Return the whitening under weights (W, N, M), in one over the noise of the sensors."""
        key = weight.numpy().tobytes()
        if key not in self._made:
            moves = (self.moves * weight[..., None]).flatten(1, 2)
            square, vectors = torch.linalg.eigh(moves.mT @ moves)
            grown = torch.sqrt(1.0 + square.clamp_min(0.0))
            # (1 - 1 / g) / (g^2 - 1) and (g - 1) / (g^2 - 1), also where g is 1.
            out, back = 1.0 / (grown * (1.0 + grown)), 1.0 / (1.0 + grown)
            self._made.clear()
            self._made[key] = Whitening(
                moves,
                (vectors * out[:, None]) @ vectors.mT,
                (vectors * back[:, None]) @ vectors.mT,
                moves @ (vectors / grown[:, None]),
            )
        return self._made[key]

    def take(self, index: Tensor) -> Wander:
        """Select windows."""
        return replace(self, moves=self.moves[index])

    def none(self, value: Tensor) -> Wander:
        """Return no moves of measurements (W, N, M)."""
        return replace(self, moves=torch.zeros(*value.shape, 1, dtype=torch.float64))

    def times(self, factor: float) -> Wander:
        """Return noise that is larger by a factor."""
        return replace(self, sd=tuple(factor * sd for sd in self.sd), moves=factor * self.moves)


def joined(a: Wander, b: Wander) -> Wander:
    """Return the noise of two sets of windows together."""
    most = max(a.moves.shape[-1], b.moves.shape[-1])
    moves = [torch.nn.functional.pad(own.moves, (0, most - own.moves.shape[-1])) for own in (a, b)]
    return replace(a, moves=torch.cat(moves))


def compressed(moves: Tensor, weight: Tensor, share: float, most: int) -> tuple[Tensor, Tensor]:
    """Return moves (W, N, M, K) in the few pieces of noise that make most of the covariance, and what they leave of it.

    Args:
        moves: (W, N, M, P) moves by each piece of noise.
        weight: (W, N, M) one over the noise of the sensors.
        share: Variance of a typical sample, in noise variances, that may be left.
        most: Largest number of pieces.

    Returns:
        The moves, and (N,) variances of the channels that are left, in their units.
    """
    w, n, m, pieces = moves.shape
    weighted = (moves * weight[..., None]).flatten(1, 2)
    square, vectors = torch.linalg.eigh(weighted.mT @ weighted)  # ascending
    samples = (weight > 0.0).flatten(1).sum(1).clamp_min(1)
    left = (square.clamp_min(0.0).cumsum(1) / samples[:, None]).median(0).values
    dropped = max(int((left <= share).sum()), pieces - most)
    whole = moves.flatten(1, 2)
    rest = (whole @ vectors[:, :, :dropped]).square().sum(-1).reshape(w, n, m) * (weight > 0.0)
    variance = rest.sum((0, 2)) / (weight > 0.0).sum((0, 2)).clamp_min(1)
    return (whole @ vectors[:, :, dropped:]).reshape(w, n, m, pieces - dropped), variance
