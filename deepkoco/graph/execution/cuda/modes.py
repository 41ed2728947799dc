"""Modes under which node functions run: which tensors they use, and on which device their constants are."""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map_only

FROM_PYTHON = (torch.tensor, torch.as_tensor, torch.from_numpy)
FACTORIES = frozenset(
    (torch.zeros, torch.ones, torch.full, torch.empty, torch.arange, torch.linspace, torch.eye)
)


class Watching(TorchDispatchMode):
    """Takes note of which tensors are used by any operation, those inside scripted functions included.

    Attributes:
        used: identities of the tensors.
    """

    def __init__(self) -> None:
        super().__init__()
        self.used: set[int] = set()

    def __torch_dispatch__(
        self, func: Callable[..., Any], types: Any, args: Any = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        self.note(tree_leaves((args, kwargs)))
        return func(*args, **(kwargs or {}))

    def note(self, values: Iterable[Any]) -> None:
        """Count tensors as used."""
        self.used |= {id(value) for value in values if isinstance(value, Tensor)}


class OnDevice(TorchFunctionMode):
    """Brings the constants of node functions to the device on which everything else is.

    Nodes may hold tensors on the CPU and make new ones; where these meet tensors of the device, copies on
    the device take their place. While a CUDA graph is captured nothing can be copied from the host: the
    n-th constant of a run is then the copy that an earlier run made, if its numbers are the same.

    Args:
        device: where everything is.
    """

    def __init__(self, device: torch.device) -> None:
        super().__init__()
        self.device = device
        self._copies: list[tuple[Tensor, Tensor]] = []
        self._next = 0

    def __enter__(self) -> "OnDevice":
        self._next = 0
        return super().__enter__()

    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: Any = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        kwargs = kwargs or {}
        if func in FACTORIES and kwargs.get("device") is None:
            return func(*args, **kwargs | {"device": self.device})
        tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, Tensor)]
        on_device = any(tensor.device.type == self.device.type for tensor in tensors)
        if on_device and any(self._is_constant(tensor) for tensor in tensors):
            args = tree_map_only(Tensor, self._moved, args)
            kwargs = {name: tree_map_only(Tensor, self._moved, value) for name, value in kwargs.items()}
        result = func(*args, **kwargs)
        return self._moved(result) if func in FROM_PYTHON and isinstance(result, Tensor) else result

    def _is_constant(self, tensor: Tensor) -> bool:
        return tensor.device.type == "cpu" and self.device.type != "cpu"

    def _moved(self, tensor: Tensor) -> Tensor:
        if not self._is_constant(tensor):
            return tensor
        place, self._next = self._next, self._next + 1
        if place < len(self._copies):
            known, copy = self._copies[place]
            if known.dtype == tensor.dtype and torch.equal(known, tensor):
                return copy
        copy = tensor.to(self.device)
        self._copies[place : place + 1] = [(tensor.clone(), copy)]
        return copy
