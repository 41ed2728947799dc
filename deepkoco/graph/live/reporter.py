"""Reports: what nodes record goes to who writes it down, in a thread beside them, while they run."""

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection as Pipe
from threading import Thread
from typing import Any, NamedTuple

from deepkoco.graph.live.driver import Driver
from deepkoco.graph.live.seat import Seat

REPORT_PERIOD = 0.02  # from one report to the next [s]


class Report(NamedTuple):
    """What one node has recorded since its last report.

    Attributes:
        position: number of the node in the graph.
        episode: number of the reset since which it counts.
        news: as `Driver.news` gives it.
    """

    position: int
    episode: int
    news: dict[str, Any]


def reports_of(drivers: Iterable[tuple[int, Driver | None]]) -> Iterator[Report]:
    """Give what is new in drivers; each with the number of its node, None between episodes."""
    for position, driver in drivers:
        news = None if driver is None else driver.news()
        if driver is not None and news is not None:
            yield Report(position, driver.episode, news)


class Reporter(Thread):
    """Sends what the nodes of a process record; a full pipe holds up this thread, not the nodes.

    Args:
        seats: the nodes, by number.
        pipe: where the reports go.
    """

    def __init__(self, seats: Mapping[int, Seat], pipe: Pipe) -> None:
        super().__init__(name="reports", daemon=True)
        self._seats, self._pipe = seats, pipe

    def run(self) -> None:
        """Report until the process ends, or until nobody reads."""
        with suppress(OSError):
            while True:
                time.sleep(REPORT_PERIOD)
                for report in reports_of((n, seat.driver) for n, seat in self._seats.items()):
                    self._pipe.send(report)
