"""What goes wrong between two machines."""

from deepkoco.graph.live.failure import NodeFailure


class ConnectionRefused(ValueError):
    """The two ends do not come together; the message says why and what to do."""


class LinkFailure(NodeFailure):
    """The connection between the two machines has ended, or the other end has stopped.

    Args:
        reason: what happened, in words.
    """

    def __init__(self, reason: str) -> None:
        RuntimeError.__init__(self, f"{reason}; the graph is stopped")
        self.cause = self.reason = reason
        self.node, self.tick, self.details = "", -1, ""
        self.closed_after: dict[str, float] = {}

    def __reduce__(self) -> tuple[type, tuple[str]]:
        return type(self), (self.reason,)
