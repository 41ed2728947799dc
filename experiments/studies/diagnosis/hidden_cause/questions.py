"""What an entrant is handed, what it answers, and what only the judge knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from deepkoco.fit.data.windows import Windows
from deepkoco.logs.recording import Recording
from deepkoco.systems import System

# Windows without measurements, start states (L, W, 2 J) -> readings (L, W, N, M) at the stamps of the windows.
Simulate = Callable[[Windows, Tensor], Tensor]


@dataclass(frozen=True)
class Handed:
    """What every entrant gets of a case, and nothing else.

    Attributes:
        system: The model as given: equations, named parameters with priors, channels.
        xml: The same model as MJCF text; None for a system that is no MJCF.
        log: The log to explain.
        healthy: Logs of the unit in which nothing is wrong, as far as its owner knows.
        window: Length of the held-out windows [s].
        seed: For what an entrant draws itself.
    """

    system: System
    xml: str | None
    log: tuple[Recording, ...]
    healthy: tuple[Recording, ...]
    window: float
    seed: int


@dataclass(frozen=True)
class Answer:
    """What an entrant says about a case.

    Attributes:
        name: "nothing", "unknown", or the first cause with its place, in the names of the catalogue.
        members: Names that the entrant cannot tell from it.
        simulate: Its simulation: windows, whose measurements are left out, and start states (L, W, 2 J), positions
            before speeds, to readings (L, W, N, M). The judge searches the start states of every entrant alike.
        note: Anything worth keeping in the row.
    """

    name: str
    members: tuple[str, ...]
    simulate: Simulate
    note: str = ""


class Entrant(Protocol):
    """A method that takes part.

    Attributes:
        name: Its name in the table.
    """

    name: str

    def answer(self, handed: Handed) -> Answer:
        """Explain a case."""
        ...


@dataclass(frozen=True)
class Truth:
    """What only the judge knows of a case.

    Attributes:
        case: Name of the case.
        kind: Kind of what is hidden, or "nothing"; of a real log, what is known of it.
        inside: Whether the catalogue has it.
        joint: Where it acts.
        sizes: Its numbers.
        right: Right answers; empty where nobody knows.
        strength: What it does in one second, in standard deviations of the position's noise.
        robot: Name of the model.
        condition: Which healthy logs there are.
        seconds: Length of the log to explain [s].
        held: Held-out windows with their measurements; None where there is no such log.
    """

    case: str
    kind: str
    inside: bool
    joint: str
    sizes: str
    right: frozenset[str]
    strength: float
    robot: str
    condition: str
    seconds: float
    held: Windows | None


@dataclass(frozen=True)
class Question:
    """One case of the benchmark."""

    handed: Handed
    truth: Truth
