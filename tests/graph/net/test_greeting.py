"""Two ends that do not belong together say so, and what to do."""

import contextlib
import json
import socket
import struct
import time

import pytest
import torch
from two_ends import AMPLE, Serving, leading, motor_graph, push

import deepkoco.graph.net.greeting as greeting
from deepkoco.graph import GraphError
from deepkoco.graph.episodes.storage.container import EpisodeFileError
from deepkoco.graph.net import ConnectionRefused, RobotEnd, RobotOptions, connect
from deepkoco.graph.net.greeting import split_address


def test_another_graph_is_refused_with_the_entry_that_differs(tmp_path):
    with (
        Serving(motor_graph(tmp_path, rate=50), ["motor"]) as serving,
        pytest.raises(
            ConnectionRefused, match=r"graph\.nodes\.motor\.rate_hz is 100 at the end that leads and 50"
        ),
    ):
        connect(motor_graph(tmp_path, rate=100), serving.address)


def test_the_leader_needs_no_driver_of_the_robot(tmp_path):
    class Stand(type(motor_graph(tmp_path).node("motor"))):
        def open(self):
            raise AssertionError("there is no motor here")

    graph = motor_graph(tmp_path)
    graph.nodes[0].__class__ = Stand
    with Serving(motor_graph(tmp_path), ["motor"]) as serving, leading(graph, serving.address) as runtime:
        runtime.reset({}, torch.Generator())
        runtime.run(push, 3)


def test_another_version_is_refused(tmp_path, monkeypatch):
    with Serving(motor_graph(tmp_path), ["motor"]) as serving:
        true = greeting.__version__
        monkeypatch.setattr(greeting, "greet", greeting.greet)
        connection = socket.create_connection(serving.address.split(":"))
        hello = greeting.frame(greeting.Kind.HELLO, b'{"version": "0.0.9", "graph": {}}')
        connection.sendall(greeting.GREETING.pack(greeting.MAGIC, greeting.PROTOCOL) + hello)
        kind, content = greeting._next(connection)
        connection.close()
    assert kind == greeting.Kind.REFUSAL
    assert f"0.0.9 leads and {true} runs here: install the same version" in content["reason"]


def test_another_protocol_is_named(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        client = socket.create_connection(listener.getsockname())
        server, _ = listener.accept()
        server.sendall(greeting.GREETING.pack(greeting.MAGIC, 7) + bytes(5))
        with pytest.raises(
            ConnectionRefused, match=r"speaks protocol 7, .* install the same version on both"
        ):
            greeting._next(client)
        client.close()
        server.close()


def test_a_stranger_is_sent_away_and_the_robot_waits_on(tmp_path):
    with Serving(motor_graph(tmp_path), ["motor"]) as serving:
        with socket.create_connection(serving.address.split(":")) as stranger:
            stranger.sendall(b"GET / HTTP/1.1\r\n\r\n")
            with contextlib.suppress(ConnectionResetError):  # it has not read all that was sent
                assert stranger.recv(100) == b""
        assert "is no deepkoco" in serving.said[-1]
        with leading(motor_graph(tmp_path), serving.address) as runtime:
            runtime.reset({}, torch.Generator())


def hello(graph) -> bytes:
    said = {
        "version": greeting.__version__,
        "graph": greeting.comparable(graph),
        "session": "0123",
        "pid": 1,
    }
    return greeting.frame(greeting.Kind.HELLO, json.dumps(said).encode())


def reset_at_once(connection, graph, start):
    connection.sendall(start + hello(graph))
    # Closing resets the connection, whatever the robot's end does with it just now.
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def nest_deeply(connection, graph, start):
    connection.sendall(start + greeting.frame(greeting.Kind.HELLO, b"[" * 200_000))


def say_nothing(connection, graph, start):
    pass


@pytest.mark.parametrize("guest", [reset_at_once, nest_deeply, say_nothing])
def test_whoever_connects_the_robot_waits_on_for_a_leader(tmp_path, monkeypatch, guest):
    monkeypatch.setattr(greeting, "HELLO_PATIENCE", 0.3)
    monkeypatch.setattr(greeting, "PATIENCE", AMPLE)
    graph = motor_graph(tmp_path)
    start = greeting.GREETING.pack(greeting.MAGIC, greeting.PROTOCOL)
    with Serving(motor_graph(tmp_path), ["motor"], sessions=None) as serving:
        for _ in range(5 if guest is reset_at_once else 1):
            with socket.create_connection(serving.address.split(":")) as connection:
                guest(connection, graph, start)
                until, away = time.monotonic() + AMPLE, None
                while away is None and time.monotonic() < until:
                    with contextlib.suppress(
                        ConnectionRefused
                    ):  # a session of the guest's may be about to end
                        away = connect(graph, serving.address)
            assert away is not None
            away.close()


def test_a_leader_waits_longer_than_one_who_says_nothing_may_take():
    assert greeting.HELLO_PATIENCE < greeting.PATIENCE / 2


def test_a_session_that_cannot_begin_is_refused_with_the_reason_and_the_next_one_begins(tmp_path):
    folder = tmp_path / "robot"
    with Serving(motor_graph(tmp_path), ["motor"], record=folder) as serving:
        folder.rmdir()
        folder.write_text("in the way")
        with pytest.raises(ConnectionRefused, match=r"cannot begin a session: .*File exists"):
            connect(motor_graph(tmp_path), serving.address)
        folder.unlink()
        with leading(motor_graph(tmp_path), serving.address) as runtime:
            runtime.reset({}, torch.Generator())


def test_the_folder_of_recordings_may_be_text_and_is_made_at_the_start(tmp_path):
    folder = tmp_path / "of" / "robot"
    with Serving(motor_graph(tmp_path), ["motor"], record=str(folder)) as serving:
        assert folder.is_dir()
        with leading(motor_graph(tmp_path), serving.address) as runtime:
            runtime.reset({}, torch.Generator())
            runtime.run(push, 3)
            runtime.finish()
        serving.thread.join(AMPLE)
    assert (folder / "session_0000.mcap").exists()


def test_a_folder_that_cannot_be_made_is_named_at_the_start(tmp_path):
    (tmp_path / "file").write_text("in the way")
    options = RobotOptions(record=tmp_path / "file" / "robot")
    with pytest.raises(EpisodeFileError, match="robot: the folder of the recordings cannot be made"):
        RobotEnd(motor_graph(tmp_path), ["motor"], "127.0.0.1:0", options)


def test_a_second_leader_is_refused_while_a_session_runs(tmp_path):
    with (
        Serving(motor_graph(tmp_path), ["motor"]) as serving,
        leading(motor_graph(tmp_path), serving.address) as runtime,
    ):
        runtime.reset({}, torch.Generator())
        with pytest.raises(ConnectionRefused, match="another machine leads this robot already"):
            connect(motor_graph(tmp_path), serving.address)


def test_nobody_there_and_a_port_in_use_say_what_to_do(tmp_path):
    graph = motor_graph(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConnectionRefused, match=rf"the port is in use; end the other program .*{port}"):
            RobotEnd(graph, ["motor"], f"127.0.0.1:{port}")
    with pytest.raises(ConnectionRefused, match="Connection refused; start `deepkoco serve` there"):
        connect(graph, f"127.0.0.1:{port}")


def test_the_supervisor_and_unknown_nodes_do_not_run_at_the_robot(tmp_path):
    graph = motor_graph(tmp_path)
    for nodes, words in (
        (["agent"], "stays at the end that leads"),
        (["arm"], "is no node"),
        ([], "no node is to"),
    ):
        with pytest.raises(GraphError, match=words):
            RobotEnd(graph, nodes, "127.0.0.1:0")


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("robot:9", ("robot", 9)),
        ("robot", ("robot", 7411)),
        ("[::1]:9", ("::1", 9)),
        ("[::1]", ("::1", 7411)),
    ],
)
def test_addresses(text, address):
    assert split_address(text) == address


@pytest.mark.parametrize("text", ["", ":9", "robot:x", "robot:70000"])
def test_what_is_no_address_is_refused(text):
    with pytest.raises(ConnectionRefused, match="give HOST:PORT"):
        split_address(text)
