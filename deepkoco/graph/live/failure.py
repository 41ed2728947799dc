"""Failures: what went wrong, in which node, at which of its ticks, and how an episode is marked with it."""

from dataclasses import replace
from typing import NamedTuple

from deepkoco.graph.episodes.episode import Episode, Note


class NodeFailure(RuntimeError):
    """A node raised, did not return or died; the graph has stopped and every node that could be was closed.

    Attributes:
        node: its name.
        tick: the step that failed; -1 before its first step.
        reason: what happened, in words.
        cause: node, tick and reason.
        details: the traceback in the node's process, if there was one.
        closed_after: by node name, time from noticing the failure to the end of its `close` [s], negative where
            it had closed before; without the nodes that could not be closed.
    """

    def __init__(self, node: str, tick: int, reason: str, details: str = "") -> None:
        where = f"at its tick {tick}" if tick >= 0 else "before its first tick"
        self.cause = f'node "{node}" {where}: {reason}'
        super().__init__(f"{self.cause}; the graph is stopped")
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


class Ending(NamedTuple):
    """What ended an episode before its time.

    Attributes:
        note: for people.
        failure: as in `Episode`; empty where the caller only stopped (Ctrl-C).
    """

    note: Note
    failure: str

    @classmethod
    def of(cls, error: BaseException, supervisor: str, t: float) -> "Ending":
        """Describe an error that stops a graph: of a node, or of the caller, at time `t` of the episode [s]."""
        if isinstance(error, NodeFailure):
            return cls(Note(t, "fatal", error.node, error.cause), error.cause)
        text = f"the caller stopped it: {type(error).__name__}" + (f": {error}" if str(error) else "")
        if isinstance(error, Exception):
            return cls(Note(t, "fatal", supervisor, text), text)
        return cls(Note(t, "warning", supervisor, text), "")

    def mark(self, episode: Episode) -> Episode:
        """Return the episode with the note and the failure."""
        return replace(episode, notes=(*episode.notes, self.note), failure=self.failure)
