"""Failures: what went wrong, in which node, at which of its ticks."""


class NodeFailure(RuntimeError):
    """A node raised, did not return or died; the graph has stopped and every node that could be was closed.

    Attributes:
        node: its name.
        tick: the step that failed; -1 before its first step.
        reason: what happened, in words.
        details: the traceback in the node's process, if there was one.
        closed_after: by node name, time from noticing the failure to the end of its `close` [s], negative where
            it had closed before; without the nodes that could not be closed.
    """

    def __init__(self, node: str, tick: int, reason: str, details: str = "") -> None:
        where = f"at its tick {tick}" if tick >= 0 else "before its first tick"
        super().__init__(f'node "{node}" {where}: {reason}; the graph is stopped')
        self.node, self.tick, self.reason, self.details = node, tick, reason, details
        self.closed_after: dict[str, float] = {}
        if details:
            self.add_note(details)

    def __reduce__(self) -> tuple[type, tuple[str, int, str, str]]:
        return type(self), (self.node, self.tick, self.reason, self.details)


def failure_of(node: str, tick: int, error: BaseException, details: str = "") -> NodeFailure:
    """Describe an exception of a node."""
    if isinstance(error, NodeFailure):
        return error
    return NodeFailure(node, tick, f"{type(error).__name__}: {error}", details)
