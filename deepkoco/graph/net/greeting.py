"""The greeting: two ends find out that they belong together before anything moves."""

import json
import os
import socket
import time
from collections.abc import Mapping
from typing import Any

from deepkoco import __version__
from deepkoco.graph.episodes.storage.description import describe_graph
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.net.failure import ConnectionRefused
from deepkoco.graph.net.wire import GREETING, MAGIC, PROTOCOL, FrameReader, Kind, WireError, frame

PATIENCE = 5.0  # what the robot's end gets to answer [s]
HELLO_PATIENCE = 1.5
"""What who connects gets to say hello [s]; shorter, so that a leader behind one who says nothing is still heard."""
PORT = 7411
LONGEST_GREETING = 1 << 24  # bytes


def split_address(text: str) -> tuple[str, int]:
    """Split HOST:PORT; the port may be left out, and IPv6 addresses stand in brackets.

    Raises:
        ConnectionRefused: it is none.
    """
    host, colon, port = text.rpartition(":")
    if not colon or (":" in host and not host.endswith("]")):
        host, port = text, str(PORT)
    if not host or not port.isdigit() or int(port) > 65535:
        raise ConnectionRefused(f'"{text}": give HOST:PORT, for example 192.168.0.7:{PORT}')
    return host.strip("[]"), int(port)


def greet(connection: socket.socket, graph: Graph, session: str) -> dict[str, Any]:
    """Introduce this end, which leads; return what the other one says of itself.

    Args:
        connection: connected, blocking.
        graph: what is to run.
        session: a name for this run, that both recordings bear.

    Raises:
        ConnectionRefused: the other end is none of ours, or does not want to.
    """
    hello = {"version": __version__, "graph": comparable(graph), "session": session, "pid": os.getpid()}
    connection.settimeout(PATIENCE)
    connection.sendall(GREETING.pack(MAGIC, PROTOCOL) + frame(Kind.HELLO, json.dumps(hello).encode()))
    kind, content = _next(connection, PATIENCE)
    if kind == Kind.REFUSAL:
        raise ConnectionRefused(str(content.get("reason", "no reason given"))[:2000])
    if kind != Kind.WELCOME or not isinstance(content.get("nodes"), list):
        raise ConnectionRefused("the other end does not answer the greeting as it should")
    unknown = [name for name in content["nodes"] if name not in graph.index]
    if unknown or graph.supervisor in content["nodes"]:
        raise ConnectionRefused(f"the other end says it runs {', '.join(map(str, content['nodes']))[:200]}")
    return content


def hear(connection: socket.socket, graph: Graph) -> dict[str, Any]:
    """Hear out who connects, and refuse who does not fit; return what it says of itself.

    Raises:
        ConnectionRefused: it does not fit; it has been told.
    """
    _, content = _next(connection, HELLO_PATIENCE)
    try:
        _compare(content, graph)
    except ConnectionRefused as error:
        refuse(connection, str(error))
        raise
    return content


def welcome(connection: socket.socket, **facts: Any) -> None:
    """Accept who has connected."""
    connection.sendall(
        GREETING.pack(MAGIC, PROTOCOL)
        + frame(Kind.WELCOME, json.dumps({"version": __version__} | facts).encode())
    )


def refuse(connection: socket.socket, reason: str) -> None:
    """Say why not."""
    body = frame(Kind.REFUSAL, json.dumps({"reason": reason}).encode())
    connection.sendall(GREETING.pack(MAGIC, PROTOCOL) + body)


def comparable(graph: Graph) -> dict[str, Any]:
    """What both ends must have in common: all but the classes of the nodes, which only one of them needs to have."""
    described = describe_graph(graph)
    nodes = [{key: value for key, value in node.items() if key != "kind"} for node in described["nodes"]]
    return json.loads(json.dumps(described | {"nodes": nodes}))


def _compare(hello: Mapping[str, Any], graph: Graph) -> None:
    if hello.get("version") != __version__:
        raise ConnectionRefused(
            f"deepkoco {str(hello.get('version'))[:40]} leads and {__version__} runs here: install the same version on "
            "both machines"
        )
    theirs, ours = hello.get("graph"), comparable(graph)
    if not isinstance(theirs, Mapping):
        raise ConnectionRefused("the greeting holds no graph")
    if theirs != ours:
        raise ConnectionRefused(
            f"the two ends have different graphs: {_difference(theirs, ours)}; start both from the same file"
        )


def _difference(theirs: Any, ours: Any, path: str = "graph") -> str:
    """Name the first entry in which two descriptions differ."""
    if isinstance(theirs, Mapping) and isinstance(ours, Mapping):
        for key in (*ours, *(key for key in theirs if key not in ours)):
            if theirs.get(key) != ours.get(key):
                return _difference(theirs.get(key), ours.get(key), f"{path}.{key}")
    if isinstance(theirs, list) and isinstance(ours, list) and len(theirs) == len(ours):
        for number, (one, other) in enumerate(zip(theirs, ours, strict=True)):
            if one != other:
                name = other.get("name") or number if isinstance(other, Mapping) else number
                return _difference(one, other, f"{path}.{name}")
    return f"{path} is {str(theirs)[:80]} at the end that leads and {str(ours)[:80]} at the robot"


def _next(connection: socket.socket, patience: float = PATIENCE) -> tuple[int, dict[str, Any]]:
    """Read the first bytes and the first frame, and not a byte more, within `patience` [s].

    Raises:
        ConnectionRefused: they are none of ours, or do not come.
    """
    until = time.monotonic() + patience
    try:
        magic, protocol = GREETING.unpack(_exactly(connection, GREETING.size, until))
        if magic != MAGIC:
            raise ConnectionRefused("the other end is no deepkoco; check address and port")
        if protocol != PROTOCOL:
            raise ConnectionRefused(
                f"the other end speaks protocol {protocol}, and deepkoco {__version__} speaks {PROTOCOL}: install the "
                "same version on both machines"
            )
        head = _exactly(connection, 5, until)
        length = int.from_bytes(head[:4], "little")
        if length > LONGEST_GREETING:
            raise ConnectionRefused("the other end's greeting is too long")
        (one,) = FrameReader().feed(head + _exactly(connection, length, until))
        content = json.loads(one.body)
        if not isinstance(content, dict):
            raise ConnectionRefused("the other end's greeting is no JSON object")
        return one.kind, content
    except TimeoutError:
        raise ConnectionRefused(
            f"the other end does not greet within {patience:g} s; is it `deepkoco serve`?"
        ) from None
    except (WireError, ValueError, RecursionError) as error:
        if isinstance(error, ConnectionRefused):
            raise
        raise ConnectionRefused(f"the other end's greeting cannot be read ({error})") from error


def _exactly(connection: socket.socket, size: int, until: float) -> bytes:
    data = b""
    while len(data) < size:
        connection.settimeout(max(0.001, until - time.monotonic()))
        piece = connection.recv(size - len(data))
        if not piece:
            raise ConnectionRefused("the other end closed the connection before it greeted")
        data += piece
    return data
