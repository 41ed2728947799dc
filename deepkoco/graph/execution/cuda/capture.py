"""Capture: work on a CUDA device recorded once and started again as a whole."""

from collections.abc import Callable

import torch

from deepkoco.graph.model.node import GraphError

WARM_UPS = 3  # runs before a capture, in which libraries allocate and choose what they do lazily


class Captured:
    """Work on fixed tensors, captured as a CUDA graph.

    Args:
        work: launches the same operations on the same tensors whenever it is called.
        prepare: sets the tensors that `work` changes to valid numbers before it runs.
        device: a CUDA device.
        running: returns the name of what `work` calls at the moment, for errors.

    Raises:
        GraphError: `work` waits for the device or moves data to or from the host.
    """

    def __init__(
        self,
        work: Callable[[], None],
        prepare: Callable[[], None],
        device: torch.device,
        running: Callable[[], str],
    ) -> None:
        with torch.cuda.device(device):
            # Lazy initialisation must not be captured, and must not happen on the stream that others use.
            side = torch.cuda.Stream(device)
            side.wait_stream(torch.cuda.current_stream(device))
            with torch.cuda.stream(side):
                for _ in range(WARM_UPS):
                    prepare()
                    work()
            torch.cuda.current_stream(device).wait_stream(side)
            self._graph = torch.cuda.CUDAGraph()
            try:
                with torch.cuda.graph(self._graph):
                    work()
            except RuntimeError as error:
                raise GraphError(
                    f"{running()} cannot be captured as a CUDA graph: it reads a value on the host, moves data "
                    f"from there, or has a shape that depends on values ({error}); use torch.where instead of "
                    'if, keep constants in tensors, or choose executor="eager"'
                ) from error

    def __call__(self) -> None:
        """Run the work again on what the tensors hold now."""
        self._graph.replay()
