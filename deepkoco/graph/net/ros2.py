"""ROS 2: a topic as a node of the graph that is read, or that a command is written to."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.extras import install_command
from deepkoco.graph.model.node import Input, Node, Parameters, State

PATIENCE = 10.0  # what the first message of a topic may take [s]


class RosError(RuntimeError):
    """ROS 2 is not there, a message has other entries than were named, or a topic is silent."""


class RosReader(Node):
    """Puts out the numbers of the newest message of a topic, (1, N) float64.

        RosReader("joints", 100, "/joint_states", "sensor_msgs/JointState", ("position", "velocity"))

    Args:
        name: unique in the graph.
        rate: ticks per second [Hz].
        topic: its name.
        kind: PACKAGE/MESSAGE.
        entries: attributes of the message, in this order; a dot leads into parts ("twist.linear.x"). Lists give all
            their numbers.
        silence: longest time without a message [s], after which a step fails and the graph is stopped; None: any.
        options: as for `Node`.
    """

    inputs = ()
    pure = False

    def __init__(
        self,
        name: str,
        rate: float,
        topic: str,
        kind: str = "std_msgs/Float64MultiArray",
        entries: Sequence[str] = ("data",),
        silence: float | None = None,
        **options: Any,
    ) -> None:
        super().__init__(name, rate, **options)
        self.topic, self.kind, self.entries, self.silence = topic, kind, tuple(entries), silence
        self._ros: _Ros | None = None
        self._newest: tuple[np.ndarray, float] | None = None

    def open(self) -> None:
        self._ros = _Ros(self.name)
        self._ros.subscribe(self.topic, _message_class(self.kind), self._take)

    def close(self) -> None:
        ros, self._ros = self._ros, None
        if ros is not None:
            ros.close()

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        until = time.monotonic() + PATIENCE
        while self._newest is None and time.monotonic() < until:
            time.sleep(0.01)
        if self._newest is None:
            raise RosError(
                f'no message of {self.kind} came on topic "{self.topic}" within {PATIENCE:g} s; `ros2 topic info '
                f"{self.topic}` says who sends on it, and of which kind"
            )
        return {}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return self._last()

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        assert self._newest is not None
        age = time.monotonic() - self._newest[1]
        if self.silence is not None and age > self.silence:
            raise RosError(
                f'topic "{self.topic}": no message for {age * 1e3:.0f} ms, and {self.silence * 1e3:.0f} ms is the limit'
            )
        return state, self._last()

    def _take(self, message: Any) -> None:
        self._newest = numbers_of(message, self.entries), time.monotonic()

    def _last(self) -> Tensor:
        assert self._newest is not None
        return torch.from_numpy(self._newest[0])[None]


class RosWriter(Node):
    """Sends each command that it sees on a topic; after an episode and when it is closed it sends zeros.

    Where its process is killed nothing more comes on the topic: what drives the motors must stop them by itself then.

    Args:
        name: unique in the graph.
        rate: ticks per second [Hz].
        size: numbers of a command.
        topic: its name.
        kind: PACKAGE/MESSAGE.
        entries: attributes of the message that get the numbers, in this order; a list gets all that are left.
        sender: name of the input.
        options: as for `Node`.
    """

    pure = False

    def __init__(
        self,
        name: str,
        rate: float,
        size: int,
        topic: str,
        kind: str = "std_msgs/Float64MultiArray",
        entries: Sequence[str] = ("data",),
        sender: str = "agent",
        **options: Any,
    ) -> None:
        super().__init__(name, rate, **options)
        self.size, self.topic, self.kind, self.entries, self.sender = (
            size,
            topic,
            kind,
            tuple(entries),
            sender,
        )
        self._ros: _Ros | None = None

    def open(self) -> None:
        self._ros = _Ros(self.name)
        self._make = _message_class(self.kind)
        self._ros.advertise(self.topic, self._make)

    def rest(self) -> None:
        assert self._ros is not None
        self._ros.send(with_numbers(self._make(), self.entries, np.zeros(self.size)))

    def close(self) -> None:
        if self._ros is not None:
            self.rest()
            self._ros.close()
            self._ros = None

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.zeros(batch, self.size, dtype=torch.float64)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        command = inputs[self.sender].data[:, -1].to(torch.float64)
        assert self._ros is not None
        self._ros.send(with_numbers(self._make(), self.entries, command[0].numpy()))
        return state, command


def numbers_of(message: Any, entries: Sequence[str]) -> np.ndarray:
    """Collect the numbers of some attributes of a message, (N,) float64.

    Raises:
        RosError: an attribute is missing, or holds no numbers.
    """
    found = []
    for entry in entries:
        holder, last = _holder(message, entry)
        try:
            found.append(np.ravel(np.asarray(getattr(holder, last), dtype=np.float64)))
        except (TypeError, ValueError) as error:
            raise RosError(f'"{entry}" of {type(message).__name__} holds no numbers') from error
    return np.concatenate(found)


def with_numbers(message: Any, entries: Sequence[str], numbers: np.ndarray) -> Any:
    """Put numbers (N,) into attributes of a message, and return it.

    Raises:
        RosError: an attribute is missing, or there are more or fewer numbers than attributes.
    """
    left: Iterator[float] = iter(numbers.tolist())
    for entry in entries:
        holder, last = _holder(message, entry)
        if np.ndim(getattr(holder, last)):
            setattr(holder, last, list(left))
        elif (value := next(left, None)) is None:
            raise RosError(f"{len(numbers)} numbers are too few for {', '.join(entries)}")
        else:
            setattr(holder, last, value)
    if surplus := len(list(left)):
        raise RosError(f"{surplus} of {len(numbers)} numbers are left over after {', '.join(entries)}")
    return message


def _holder(message: Any, entry: str) -> tuple[Any, str]:
    """What has the last attribute of a path, and its name."""
    *parts, last = entry.split(".")
    holder = message
    for part in (*parts, last):
        if not hasattr(holder, part):
            raise RosError(f'{type(message).__name__} has no "{entry}"')
        holder = holder if part is last else getattr(holder, part)
    return holder, last


def _message_class(kind: str) -> Any:
    package, _, name = kind.rpartition("/")
    try:
        return getattr(import_module(f"{package.removesuffix('/msg')}.msg"), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise RosError(
            f'there is no ROS 2 message "{kind}" ({error}); give PACKAGE/MESSAGE, and install the package'
        ) from error


class _Ros:
    """A ROS node of its own, whose callbacks run in a thread until it is closed."""

    def __init__(self, name: str) -> None:
        try:
            import rclpy  # pyright: ignore[reportMissingImports]
            from rclpy.executors import SingleThreadedExecutor  # pyright: ignore[reportMissingImports]
            from rclpy.signals import SignalHandlerOptions  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise RosError(
                f"ROS 2 needs the library rclpy ({error}); source the set-up of your ROS 2, or "
                f"{install_command('ros2')}"
            ) from error
        self._context = rclpy.Context()
        # Ctrl-C belongs to the runtime, which closes the nodes.
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node(f"deepkoco_{name}", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._closed, self._publisher = threading.Event(), None
        self._thread = threading.Thread(target=self._run, name=f"ros {name}", daemon=True)
        self._thread.start()

    def subscribe(self, topic: str, kind: Any, take: Any) -> None:
        from rclpy.qos import qos_profile_sensor_data  # pyright: ignore[reportMissingImports]

        self._node.create_subscription(kind, topic, take, qos_profile_sensor_data)

    def advertise(self, topic: str, kind: Any) -> None:
        self._publisher = self._node.create_publisher(kind, topic, 1)

    def send(self, message: Any) -> None:
        assert self._publisher is not None
        self._publisher.publish(message)

    def close(self) -> None:
        self._closed.set()
        self._thread.join(1.0)
        self._executor.shutdown(0.1)
        self._node.destroy_node()
        self._context.try_shutdown()

    def _run(self) -> None:
        while not self._closed.is_set():
            self._executor.spin_once(timeout_sec=0.02)
