"""Liftings z = g(o) of models that are linear in the lifted observation: EDMDc, pykoopman, autoencoders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain, combinations, combinations_with_replacement
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class LiftingError(ValueError):
    """A lifting is not well defined, or is given too short a history."""


class Lifting(Protocol):
    """A fixed function of the last observations."""

    @property
    def observation_size(self) -> int:
        """N, entries of one observation."""
        ...

    @property
    def window(self) -> int:
        """Observations it takes: the present one and window - 1 before it."""
        ...

    @property
    def size(self) -> int:
        """p, entries of z."""
        ...

    def __call__(self, stacked: Array) -> Array:
        """Lift.

        Args:
            stacked: The last observations, newest first (..., window * N).

        Returns:
            z (..., p).
        """
        ...


def stack_history(observations: Array, window: int) -> Array:
    """Put every observation side by side with those before it.

    Args:
        observations: One episode (T, N).
        window: Observations side by side.

    Returns:
        Rows (T - window + 1, window * N), newest first; the first belongs to step window - 1.

    Raises:
        LiftingError: The episode is shorter than the window.
    """
    if len(observations) < window:
        raise LiftingError(f"an episode has {len(observations)} observations; the lifting takes {window}")
    count = len(observations) - window + 1
    return np.hstack([observations[window - 1 - i : window - 1 - i + count] for i in range(window)])


class StackedHistory:
    """The last observations of one environment side by side, newest first."""

    def __init__(self, observation_size: int, window: int) -> None:
        """Start without an observation.

        Args:
            observation_size: N.
            window: Observations side by side.
        """
        self.observation_shape = (observation_size,)
        self.observation_type = np.float64
        self._window = window
        self._stacked: list[Array] | None = None

    def reset(self) -> None:
        """Forget all observations at the start of an episode."""
        self._stacked = None

    def push(self, observation: Array) -> Array:
        """Take in the observation of this step.

        Args:
            observation: (..., N).

        Returns:
            The last observations, newest first (..., window * N).
        """
        observation = np.array(observation, np.float64)  # a caller may use its array again
        before = [observation] * (self._window - 1) if self._stacked is None else self._stacked[:-1]
        self._stacked = [observation, *before]
        return np.concatenate(self._stacked, axis=-1)


@dataclass(frozen=True)
class Identity:
    """z = o.

    Attributes:
        observation_size: N.
    """

    observation_size: int
    window = 1

    @property
    def size(self) -> int:
        """p = N."""
        return self.observation_size

    def __call__(self, stacked: Array) -> Array:
        """Lift; see `Lifting`."""
        return stacked


@dataclass(frozen=True)
class Polynomial:
    """All monomials up to a degree, in the order of scikit-learn's `PolynomialFeatures`.

    Attributes:
        observation_size: N.
        degree: Highest degree, at least 1.
        include_bias: Whether z starts with 1.
        interaction_only: Leave out powers of one entry.
    """

    observation_size: int
    degree: int = 2
    include_bias: bool = True
    interaction_only: bool = False
    window = 1

    def __post_init__(self) -> None:
        """Check the degree."""
        if self.degree < 1:
            raise LiftingError(f"degree = {self.degree}; give at least 1")

    @property
    def exponents(self) -> list[tuple[int, ...]]:
        """Indices of the multiplied entries, one tuple per monomial."""
        combine = combinations if self.interaction_only else combinations_with_replacement
        degrees = range(0 if self.include_bias else 1, self.degree + 1)
        return list(chain.from_iterable(combine(range(self.observation_size), k) for k in degrees))

    @property
    def size(self) -> int:
        """p, number of monomials."""
        return len(self.exponents)

    def __call__(self, stacked: Array) -> Array:
        """Lift; see `Lifting`."""
        return np.stack([stacked[..., list(indices)].prod(-1) for indices in self.exponents], axis=-1)


def _thin_plate(squared: Array, width: float, power: float) -> Array:
    return squared * 0.5 * np.log(np.where(squared > 0, squared, 1.0))


def _polyharmonic(squared: Array, width: float, power: float) -> Array:
    return squared ** (power / 2) * 0.5 * np.log(np.where(squared > 0, squared, 1.0))


KERNELS: dict[str, Callable[[Array, float, float], Array]] = {
    "gauss": lambda squared, width, power: np.exp(-(width**2) * squared),
    "thinplate": _thin_plate,
    "invquad": lambda squared, width, power: 1.0 / (1.0 + width**2 * squared),
    "invmultquad": lambda squared, width, power: 1.0 / np.sqrt(1.0 + width**2 * squared),
    "polyharmonic": _polyharmonic,
}
"""Radial function by name, of (squared distance, width, power)."""


@dataclass(frozen=True)
class RadialBasis:
    """Radial functions of the distance to centres, after the observation itself.

    Attributes:
        centers: (K, N).
        kernel: A name of `KERNELS`.
        width: Factor of the distance, in units of 1 / observation.
        power: Exponent of the polyharmonic kernel.
        include_observation: Whether z starts with o.

    Source: Korda and Mezic, Linear predictors for nonlinear dynamical systems, Automatica 93 (2018).
    """

    centers: Array
    kernel: str = "thinplate"
    width: float = 1.0
    power: float = 1.0
    include_observation: bool = True
    window = 1

    def __post_init__(self) -> None:
        """Check kernel and centres."""
        if self.kernel not in KERNELS:
            raise LiftingError(f'kernel = "{self.kernel}"; choose one of {", ".join(KERNELS)}')
        if self.centers.ndim != 2 or 0 in self.centers.shape:
            raise LiftingError(f"centers have shape {self.centers.shape}; give (centres, entries)")

    @property
    def observation_size(self) -> int:
        """N."""
        return self.centers.shape[1]

    @property
    def size(self) -> int:
        """p."""
        return len(self.centers) + self.include_observation * self.observation_size

    def __call__(self, stacked: Array) -> Array:
        """Lift; see `Lifting`."""
        squared = np.square(stacked[..., None, :] - self.centers).sum(-1)
        radial = KERNELS[self.kernel](squared, self.width, self.power)
        return np.concatenate((stacked, radial), -1) if self.include_observation else radial


@dataclass(frozen=True)
class ScaledRadialBasis:
    """Standardised observations, and thin-plate functions of them.

    Without scaling, the entry with the largest unit would decide every distance.

    Attributes:
        mean: Of the observations (N,).
        directions: To standardised entries (N, E), fewer than N where principal components are taken.
        centers: (K, E), standardised; K may be 0.
    """

    mean: Array
    directions: Array
    centers: Array
    window = 1

    def __post_init__(self) -> None:
        """Check that the parts fit each other."""
        shapes = self.mean.shape, self.directions.shape, self.centers.shape
        if [len(shape) for shape in shapes] != [1, 2, 2] or 0 in self.directions.shape:
            raise LiftingError(
                f"mean, directions and centers have the shapes {shapes}; give (N,), (N, E), (K, E)"
            )
        if self.directions.shape != (self.mean.size, self.centers.shape[1]):
            raise LiftingError(
                f"mean, directions and centers have the shapes {shapes}; give (N,), (N, E), (K, E)"
            )

    @property
    def observation_size(self) -> int:
        """N."""
        return self.mean.size

    @property
    def size(self) -> int:
        """p = E + K."""
        return self.directions.shape[1] + len(self.centers)

    def __call__(self, stacked: Array) -> Array:
        """Lift; see `Lifting`."""
        scaled = (stacked - self.mean) @ self.directions
        return scaled if not len(self.centers) else RadialBasis(self.centers)(scaled)


@dataclass(frozen=True)
class RandomFourier:
    """Cosines and sines of random projections, after the observation itself.

    Attributes:
        frequencies: (D, N).
        include_observation: Whether z starts with o.

    Source: Rahimi and Recht, Random features for large-scale kernel machines, NIPS 2007.
    """

    frequencies: Array
    include_observation: bool = True
    window = 1

    def __post_init__(self) -> None:
        """Check the frequencies."""
        if self.frequencies.ndim != 2 or 0 in self.frequencies.shape:
            raise LiftingError(f"frequencies have shape {self.frequencies.shape}; give (features, entries)")

    @property
    def observation_size(self) -> int:
        """N."""
        return self.frequencies.shape[1]

    @property
    def size(self) -> int:
        """p."""
        return 2 * len(self.frequencies) + self.include_observation * self.observation_size

    def __call__(self, stacked: Array) -> Array:
        """Lift; see `Lifting`."""
        angles = stacked @ self.frequencies.T
        waves = np.concatenate((np.cos(angles), np.sin(angles)), -1) / np.sqrt(len(self.frequencies))
        return np.concatenate((stacked, waves), -1) if self.include_observation else waves


@dataclass(frozen=True)
class TimeDelays:
    """The observation and earlier ones: z_k = (o_k, o_{k-d}, o_{k-2d}, ...).

    Attributes:
        observation_size: N.
        delays: Earlier observations taken, 0 or more.
        stride: d, steps between two of them.
    """

    observation_size: int
    delays: int = 1
    stride: int = 1

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.delays < 0 or self.stride < 1:
            raise LiftingError(
                f"delays = {self.delays} and stride = {self.stride}; give at least 0 and at least 1"
            )

    @property
    def window(self) -> int:
        """delays * stride + 1."""
        return self.delays * self.stride + 1

    @property
    def size(self) -> int:
        """p = N (delays + 1)."""
        return self.observation_size * (self.delays + 1)

    def __call__(self, stacked: Array) -> Array:
        """Lift; see `Lifting`."""
        history = stacked.reshape(*stacked.shape[:-1], self.window, self.observation_size)
        return history[..., :: self.stride, :].reshape(*stacked.shape[:-1], self.size)


@dataclass(frozen=True)
class FunctionLifting:
    """Any function of the last observations; it cannot be written to a file.

    Attributes:
        function: From stacked observations (..., window * N), newest first, to z (..., p).
        observation_size: N.
        size: p.
        window: Observations it takes.
    """

    function: Callable[[Array], Array]
    observation_size: int
    size: int
    window: int = 1

    def __call__(self, stacked: Array) -> Array:
        """Lift; see `Lifting`.

        Raises:
            LiftingError: The function does not give p entries.
        """
        lifted = np.asarray(self.function(stacked), dtype=np.float64)
        if lifted.shape != (*stacked.shape[:-1], self.size):
            raise LiftingError(
                f"the lifting gave shape {lifted.shape} for {stacked.shape}; "
                f"it should give {(*stacked.shape[:-1], self.size)}"
            )
        return lifted
