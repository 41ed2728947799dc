"""A feed-forward network on plain arrays: the lifting of an imported autoencoder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from deepkoco.koopman.lifting.lifting import Array, LiftingError


def _elu(x: Array) -> Array:
    return np.where(x > 0, x, np.expm1(np.minimum(x, 0.0)))


ACTIVATIONS: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "relu": (lambda x: np.maximum(x, 0.0), lambda x: (x > 0).astype(np.float64)),
    "tanh": (np.tanh, lambda x: 1.0 - np.tanh(x) ** 2),
    "sigmoid": (lambda x: expit(x), lambda x: expit(x) * expit(-x)),
    "elu": (_elu, lambda x: np.exp(np.minimum(x, 0.0))),
    "linear": (lambda x: x, np.ones_like),
}
"""Function and derivative by name."""


@dataclass(frozen=True)
class Network:
    r"""$x \mapsto W_n h_{n-1} + b_n$ with $h_i = \sigma(W_i h_{i-1} + b_i)$, as lifting, decoder or rate.

    Attributes:
        layers: Weight (out, in) and bias (out,) of each layer.
        activation: A name of `ACTIVATIONS`.
    """

    layers: tuple[tuple[Array, Array], ...]
    activation: str = "relu"
    window = 1

    def __post_init__(self) -> None:
        """Check that the layers fit each other."""
        if self.activation not in ACTIVATIONS:
            raise LiftingError(f'activation = "{self.activation}"; choose one of {", ".join(ACTIVATIONS)}')
        if not self.layers:
            raise LiftingError("a network needs at least one layer")
        inputs = None
        for i, (weight, bias) in enumerate(self.layers):
            fits = weight.ndim == 2 and inputs in (None, weight.shape[1]) and 0 not in weight.shape
            if not fits or bias.shape != weight.shape[:1]:
                raise LiftingError(
                    f"layer {i} has weight {weight.shape} and bias {bias.shape}; "
                    f"give (outputs, {inputs or 'inputs'}) and (outputs,)"
                )
            inputs = len(bias)

    @property
    def observation_size(self) -> int:
        """N, inputs."""
        return self.layers[0][0].shape[1]

    @property
    def size(self) -> int:
        """p, outputs."""
        return len(self.layers[-1][1])

    def __call__(self, stacked: Array) -> Array:
        """Evaluate at inputs (..., N): outputs (..., p)."""
        function, _ = ACTIVATIONS[self.activation]
        x = stacked
        for weight, bias in self.layers[:-1]:
            x = function(x @ weight.T + bias)
        weight, bias = self.layers[-1]
        return x @ weight.T + bias

    def jacobian(self, x: Array) -> Array:
        """Derivative of the outputs by the inputs.

        Args:
            x: One input (N,).

        Returns:
            Jacobian (p, N).
        """
        function, derivative = ACTIVATIONS[self.activation]
        jacobian = np.eye(x.size)
        for weight, bias in self.layers[:-1]:
            before = weight @ x + bias
            jacobian = derivative(before)[:, None] * (weight @ jacobian)
            x = function(before)
        return self.layers[-1][0] @ jacobian
