"""A ReLU network that returns its output and its exact Jacobian towards some of its inputs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn


class ReluNetwork(nn.Module):
    r"""Multi-layer perceptron $x \mapsto W_n h_{n-1} + b_n$, $h_i = \max(0, W_i h_{i-1} + b_i)$.

    Away from the kinks the network is piecewise affine, so its Jacobian is the product
    $W_n D_{n-1} W_{n-1} \dots D_1 W_1$ with 0/1 masks $D_i$. It costs one more pass through the layers, and
    ordinary back-propagation through it gives the second-order terms.
    """

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int) -> None:
        """Make the layers with PyTorch's default initialisation.

        Args:
            inputs: Width of the input.
            hidden: Width of each hidden layer.
            outputs: Width of the output.
        """
        super().__init__()
        widths = [inputs, *hidden, outputs]
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))

    @property
    def linears(self) -> list[nn.Linear]:
        """The layers, first to last."""
        return cast(list[nn.Linear], list(self.layers))

    def forward(self, x: Tensor) -> Tensor:
        """Evaluate the network.

        Args:
            x: Input (..., inputs).

        Returns:
            Output (..., outputs).
        """
        *hidden, last = self.linears
        for layer in hidden:
            x = torch.relu(layer(x))
        return last(x)

    def with_jacobian(self, x: Tensor, columns: int) -> tuple[Tensor, Tensor]:
        """Evaluate the network and its Jacobian towards the last inputs.

        Args:
            x: Input (..., inputs).
            columns: Number of trailing inputs to differentiate by.

        Returns:
            Output (..., outputs) and *transposed* Jacobian (..., columns, outputs).
        """
        layers = self.linears
        tangent = layers[0].weight[:, -columns:].T
        for layer, following in pairwise(layers):
            before = layer(x)
            active = (before > 0).to(before.dtype).unsqueeze(-2)
            x = torch.relu(before)
            tangent = (active * tangent) @ following.weight.T
        return layers[-1](x), tangent.expand(*x.shape[:-1], columns, -1)
