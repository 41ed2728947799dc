"""Connections: which output is whose input, and how it travels."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from numbers import Integral
from typing import Any

from torch import Tensor

from deepkoco.graph.delay import Delay, DelayError, Deterministic, make_delay
from deepkoco.graph.model.node import GraphError, Node
from deepkoco.graph.model.parts import Parts

JITTERS = ("latest", "buffer")
LONGEST_WINDOW = 1024
"""Messages that a connection remembers: every executor keeps this history for every environment."""


@dataclass(frozen=True)
class Connection:
    """A directed connection from one node's output to another's input.

    Attributes:
        sender: name of the sending node.
        receiver: name of the receiving node.
        delay: communication delay [s], a number, a law or its description.
        window: how many of the last messages a step of the receiver sees, at most `LONGEST_WINDOW`.
        skip: a message sent at the very instant of a step is for the next step; breaks cycles.
        blocking: each step waits for the messages that the sender was to start since the last tick.
        jitter: "latest" takes a message as soon as it is there, "buffer" not before its nominal arrival.
        fifo: messages cannot overtake each other.
        name: name of the input; None takes the sender's.
        parts: of the sender's output, where it has several; the graph fills it in.
    """

    sender: str
    receiver: str
    delay: Delay | float | Mapping[str, Any] = Deterministic(0.0)  # noqa: RUF009 - frozen
    window: int = 1
    skip: bool = False
    blocking: bool = False
    jitter: str = "latest"
    fifo: bool = True
    name: str | None = None
    parts: Parts | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.name is None:
            object.__setattr__(self, "name", self.sender)
        try:
            object.__setattr__(self, "delay", make_delay(self.delay))
        except DelayError as error:
            raise DelayError(f'connection "{self.key}": {error}') from error
        if not isinstance(self.window, Integral) or self.window < 1:
            raise GraphError(f'connection "{self.key}": window {self.window} is no whole number >= 1')
        if self.window > LONGEST_WINDOW:
            raise GraphError(
                f'connection "{self.key}": window {self.window} is more than the {LONGEST_WINDOW} messages '
                "that a connection remembers; keep longer histories in the state of a node"
            )
        if self.jitter not in JITTERS:
            raise GraphError(
                f'connection "{self.key}": jitter "{self.jitter}" is none of {", ".join(JITTERS)}'
            )

    @property
    def key(self) -> str:
        """Name of the connection in the graph: "sender->receiver", with ":input" if the input has its own."""
        own = "" if self.name == self.sender else f":{self.name}"
        return f"{self.sender}->{self.receiver}{own}"

    def seen(self, data: Tensor) -> Any:
        """What the receiver sees of messages (B, window, ...)."""
        return data if self.parts is None else self.parts.split(data)

    @property
    def law(self) -> Delay:
        """The communication delay as a law."""
        return make_delay(self.delay)


def wide_enough(connection: Connection, sender: Node, receiver: Node) -> Connection:
    """Return the connection with a window of at least what the receiver needs, see `Node.least_window`."""
    return replace(connection, window=max(connection.window, receiver.least_window(connection.law, sender)))
