"""The inbox of a node: messages with the instant of their arrival, and orders of the runtime."""

import time
from collections import deque
from threading import Condition
from typing import Any, NamedTuple

from deepkoco.graph.live.message import Message


class Order(NamedTuple):
    """What the runtime tells a node to do.

    Attributes:
        command: "reset", "go", "end" or "stop".
        payload: plain numbers and arrays.
    """

    command: str
    payload: Any = None


class Inbox:
    """Holds what has come for one node until its thread looks.

    Arrivals are stamped under the lock under which the node also reads the clock when it starts a step: what
    is stamped before the start has been seen, what comes after it has not.
    """

    def __init__(self) -> None:
        self._condition = Condition()
        self._messages: deque[tuple[Message, int]] = deque()
        self._orders: deque[Order] = deque()
        self._awake = True
        self.episode = -1
        self.credit = 0

    def deliver(self, message: Message) -> None:
        """Stamp a message and keep it; one of an earlier episode is dropped."""
        with self._condition:
            if message.episode == self.episode:
                self._messages.append((message, time.monotonic_ns()))
                if self._awake:
                    self._condition.notify()

    def order(self, order: Order) -> None:
        """Tell the node's thread something."""
        with self._condition:
            self._orders.append(order)
            self._condition.notify()

    def grant(self, supervisor_step: int) -> None:
        """Let a node that nothing else holds back run ahead to a step of the supervisor."""
        with self._condition:
            self.credit = supervisor_step
            self._condition.notify()

    def begin(self, episode: int) -> None:
        """Empty the inbox for an episode."""
        with self._condition:
            self.episode, self.credit = episode, 0
            self._messages.clear()

    def take(self) -> tuple[int, list[tuple[Message, int]]]:
        """Return the instant of now and all messages that came before it, with theirs [ns, monotonic]."""
        with self._condition:
            messages = list(self._messages)
            self._messages.clear()
            return time.monotonic_ns(), messages

    def ordered(self) -> bool:
        """Whether an order waits."""
        return bool(self._orders)

    def next_order(self) -> Order:
        """Wait for an order."""
        with self._condition:
            while not self._orders:
                self._condition.wait()
            return self._orders.popleft()

    def wait(self, until: int | None = None, messages: bool = True) -> None:
        """Sleep until something comes or an instant passes [ns, monotonic].

        Args:
            until: None waits without end.
            messages: whether a message ends the sleep; an order always does.
        """
        with self._condition:
            credit = self.credit
            self._awake = messages
            while not self._orders and not (messages and self._messages) and self.credit == credit:
                if until is None:
                    self._condition.wait()
                    continue
                left = until - time.monotonic_ns()
                if left <= 0:
                    break
                self._condition.wait(left * 1e-9)
            self._awake = True
