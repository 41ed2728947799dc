"""What stops a live runtime when something in it fails."""

from collections.abc import Callable

from deepkoco.graph.live.runner import InitialStateError


class Stopping:
    """Stops everything where what is inside fails: a node, the policy, Ctrl-C.

    Args:
        stop: Called with the failure.
    """

    def __init__(self, stop: Callable[[BaseException], None]) -> None:
        self._stop = stop

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        # A mistake of the caller at a reset finds the nodes idle, and leaves them so.
        if error is not None and not isinstance(error, InitialStateError):
            self._stop(error)
