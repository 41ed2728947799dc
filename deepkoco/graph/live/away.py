"""The nodes of a graph that live on another machine, as the crew of this one sees them."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from deepkoco.graph.live.failure import NodeFailure
from deepkoco.graph.live.message import Message


class Home(Protocol):
    """What the way to another machine needs of the crew of this one."""

    @property
    def correction(self) -> np.ndarray:
        """What all nodes here add to the clock of this machine to have that of the episode, (1,) int64 [ns]."""
        ...

    def arrive(self, message: Message) -> None:
        """Pass on an output that has come from another machine."""

    def hear(self, position: int, kind: str, payload: Any) -> None:
        """Take what a node on another machine, or who watches the way there, has to say; as for `Seat`."""


class Away(ABC):
    """The way to the nodes on another machine; no call waits for the network, except `farewell`.

    Attributes:
        nodes: their names.
        meta: JSON object that tells in a recording which part of which run it is.
    """

    nodes: frozenset[str]
    meta: Mapping[str, Any]

    @abstractmethod
    def start(self, crew: Home) -> None:
        """Connect with a crew: what comes goes to its `arrive` and `hear`."""

    @abstractmethod
    def send(self, message: Message) -> None:
        """Send an output to a node there."""

    @abstractmethod
    def tell(self, position: int, command: str, payload: Any) -> None:
        """Give an order to a node there, by its number in the graph."""

    @abstractmethod
    def stop(self, failure: NodeFailure | None) -> None:
        """Say that all is stopped here, and why; None: because it was wanted."""

    @abstractmethod
    def farewell(self, records: dict[str, dict[str, Any]]) -> None:
        """Part, after all nodes of this machine are closed.

        Args:
            records: by node name, what was recorded here; who leads adds what the other machine still sends.
        """

    @abstractmethod
    def close(self) -> None:
        """End the connection, where no crew will part from it; safe to call twice."""
