"""The end of the threads in which nodes live."""

import threading
import time

import numpy as np

from deepkoco.graph.live.host import PATIENCE, close_seats
from deepkoco.graph.live.seat import BUSY_SINCE, Seat
from tests.graph.timing_reference import Accumulate


class Marked(Accumulate):
    """Takes down in which threads it opens and closes."""

    def __init__(self) -> None:
        super().__init__("device", 10)
        self.threads: list[int] = []

    def open(self) -> None:
        self.threads.append(threading.get_ident())

    def close(self) -> None:
        self.threads.append(threading.get_ident())


class Late(Seat):
    """A seat whose thread gets its turn a while after the order to stop."""

    stepping = False

    def _serve(self, runner) -> None:
        self._board[BUSY_SINCE] = time.monotonic_ns() if self.stepping else 0
        super()._serve(runner)
        time.sleep(10 * PATIENCE)
        self._board[BUSY_SINCE] = 0


def closed(stepping: bool) -> list[int]:
    node, opened = Marked(), threading.Event()
    board = np.zeros((1, 4), np.int64)
    seat = Late(0, lambda: node, "device", (), {}, [], board, lambda *reply: opened.set(), 1.0)
    seat.stepping = stepping
    seat.start()
    assert opened.wait(60.0)
    close_seats({0: seat})
    return node.threads


def test_a_node_in_no_step_closes_where_it_opened_however_late_its_thread_gets_a_turn():
    opened, shut = closed(stepping=False)
    assert opened == shut


def test_a_node_whose_step_does_not_return_is_closed_from_outside():
    opened, shut = closed(stepping=True)
    assert opened != shut
    assert shut == threading.get_ident()
