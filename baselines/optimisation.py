"""Steps of Adam and of targets, each over all parameters at once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from torch import Tensor, nn
from torch.optim import Adam


def make_adam(parameters: Iterable[Tensor], learning_rate: float, beta: float = 0.9) -> Adam:
    """Adam in one fused kernel.

    Args:
        parameters: What it changes.
        learning_rate: Step size.
        beta: beta_1.
    """
    return Adam(list(parameters), lr=learning_rate, betas=(beta, 0.999), fused=True)


def descend(loss: Tensor, optimisers: Sequence[Adam]) -> None:
    """One step on a loss for what the optimisers hold; no gradient is computed for anything else.

    Args:
        loss: Scalar.
        optimisers: Each takes a step.
    """
    parameters = [p for optimiser in optimisers for group in optimiser.param_groups for p in group["params"]]
    for optimiser in optimisers:
        optimiser.zero_grad()
    loss.backward(inputs=parameters)
    for optimiser in optimisers:
        optimiser.step()


class MovingTarget:
    """A copy that follows a module: target <- target + tau (module - target)."""

    def __init__(self, module: nn.Module, target: nn.Module, rate: float) -> None:
        """Pair the parameters.

        Args:
            module: What is followed.
            target: Its copy.
            rate: tau.
        """
        self._parameters, self._rate = [p.detach() for p in module.parameters()], rate
        self._targets = [p.detach() for p in target.parameters()]

    def step(self) -> None:
        """Follow by one step."""
        if self._targets:
            torch._foreach_lerp_(self._targets, self._parameters, self._rate)  # pyright: ignore[reportPrivateImportUsage]
