"""Orthogonal starting weights, for convolutions in the middle of their kernel only."""

from __future__ import annotations

from torch import Tensor, nn


def initialise(module: nn.Module) -> None:
    """Set the starting weights of one layer; for `nn.Module.apply`.

    Linear layers start orthogonal, convolutions delta-orthogonal: an orthogonal matrix over the channels in
    the middle of the kernel, times the gain of ReLU, and zero around it. Biases start at zero.

    Args:
        module: A layer; one of another kind stays as it is.

    Source: Xiao et al. (2018), Dynamical isometry and a mean field theory of CNNs.
    """
    if isinstance(module, nn.Linear):
        nn.init.orthogonal_(module.weight)
        _zero(module.bias)
    elif isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
        nn.init.zeros_(module.weight)
        middle = module.weight.shape[2] // 2
        nn.init.orthogonal_(module.weight.data[:, :, middle, middle], nn.init.calculate_gain("relu"))
        _zero(module.bias)


def _zero(bias: Tensor | None) -> None:
    if bias is not None:
        nn.init.zeros_(bias)
