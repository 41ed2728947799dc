"""Topics as nodes: numbers of messages, and, where ROS 2 is installed, a loop over two topics."""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from deepkoco.graph import Connection, Graph, Supervisor
from deepkoco.graph.live import NodeFailure, WallClockRuntime
from deepkoco.graph.net.ros2 import RosError, RosReader, RosWriter, numbers_of, with_numbers
from tests.on_time import on_time


def twist():
    return SimpleNamespace(linear=SimpleNamespace(x=0.0, y=0.0), data=[])


def test_numbers_come_out_in_the_order_of_the_entries():
    message = SimpleNamespace(linear=SimpleNamespace(x=2.0), data=[3.0, 4.0])
    np.testing.assert_array_equal(numbers_of(message, ("data", "linear.x")), [3.0, 4.0, 2.0])


def test_numbers_go_in_in_the_order_of_the_entries_and_a_list_gets_the_rest():
    message = with_numbers(twist(), ("linear.y", "data"), np.array([1.0, 2.0, 3.0]))
    assert (message.linear.x, message.linear.y, message.data) == (0.0, 1.0, [2.0, 3.0])


def test_entries_that_do_not_fit_are_named():
    with pytest.raises(RosError, match=r'has no "linear\.z"'):
        numbers_of(twist(), ("linear.z",))
    with pytest.raises(RosError, match=r'"linear" of .* holds no numbers'):
        numbers_of(twist(), ("linear",))
    with pytest.raises(RosError, match=r"1 numbers are too few for linear\.x, linear\.y"):
        with_numbers(twist(), ("linear.x", "linear.y"), np.ones(1))
    with pytest.raises(RosError, match="1 of 2 numbers are left over"):
        with_numbers(twist(), ("linear.x",), np.ones(2))


def test_without_ros_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rclpy", None)
    with pytest.raises(RosError, match="needs the library rclpy"):
        RosReader("joints", 100, "/joints").open()


def ros_graph(silence=None) -> Graph:
    """A command goes out on a topic, and what comes on the same topic is read: a robot that obeys at once."""
    action = torch.zeros(2, dtype=torch.float64)
    return Graph(
        [
            RosReader("joints", 50, "/deepkoco_test", silence=silence),
            RosWriter("motors", 50, 2, "/deepkoco_test"),
            Supervisor("agent", 50, initial_action=action),
        ],
        [Connection("joints", "agent"), Connection("agent", "motors")],
    )


@on_time
def test_commands_go_over_a_topic_and_come_back(monkeypatch):
    pytest.importorskip("rclpy")
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "1")
    with WallClockRuntime(
        ros_graph(), threads=("joints", "motors"), time_limit=60.0, beat_limit=60.0
    ) as runtime:
        first = RosWriter("first", 50, 2, "/deepkoco_test")
        first.open()
        time.sleep(1.0)
        # Without a message the reader waits at its reset.
        stop = threading.Event()

        def knock():
            while not stop.wait(0.05):
                first.step({}, {}, {"agent": SimpleNamespace(data=torch.zeros(1, 1, 2))})  # type: ignore[dict-item]

        thread = threading.Thread(target=knock)
        thread.start()
        try:
            _, inputs = runtime.reset({}, torch.Generator())
        finally:
            stop.set()
            thread.join()
            first.close()
        assert inputs["joints"].data.shape == (1, 1, 2)
        runtime.run(lambda _: torch.tensor([[1.5, -2.5]], dtype=torch.float64), 25)
        episode = runtime.finish()
    np.testing.assert_array_equal(episode.outputs["joints"][-1], [1.5, -2.5])


def test_a_topic_on_which_nothing_comes_is_named(monkeypatch):
    pytest.importorskip("rclpy")
    monkeypatch.setattr("deepkoco.graph.net.ros2.PATIENCE", 0.2)
    runtime = WallClockRuntime(ros_graph(), threads=("joints", "motors"))
    with pytest.raises(NodeFailure, match="no message of std_msgs/Float64MultiArray came on topic"):
        runtime.reset({}, torch.Generator())
