"""The link: what it tells of its end, and that it never makes a sender wait."""

import queue
import socket
import time

import pytest
from two_ends import AMPLE

from deepkoco.graph.net.link import Link
from deepkoco.graph.net.wire import PING, PONG, Kind, frame


class End:
    """One end of a pair, with what it was told."""

    def __init__(self, connection, **options):
        self.frames, self.reasons = queue.SimpleQueue(), queue.SimpleQueue()
        self.link = Link(connection, self.frames.put, self.reasons.put, **{"silence": AMPLE, **options})
        self.link.watch(True)
        self.link.start()


def pair():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        client = socket.create_connection(listener.getsockname())
        server, _ = listener.accept()
    return client, server


def test_what_is_sent_comes_in_order_also_where_it_is_more_than_the_system_takes_at_once():
    one, other = map(End, pair())
    began = time.monotonic()
    for number in range(50):
        one.link.send(Kind.MESSAGE, bytes([number]) * 1_000_000)
    assert time.monotonic() - began < AMPLE
    for number in range(50):
        came = other.frames.get(timeout=AMPLE)
        assert came.body == bytes([number]) * 1_000_000
    one.link.close()
    other.link.close()
    assert other.link.counts.bytes_received > 50_000_000


def test_what_is_on_its_way_arrives_although_the_end_that_sent_it_closes():
    """The other end takes it slowly, and its signs of life still come."""
    client, server = pair()
    one, other = End(client), End(server)
    listen, size = other.link._take, 8_000_000
    other.link._take = lambda frame: (time.sleep(0.05), listen(frame))
    for number in range(8):
        one.link.send(Kind.MESSAGE, bytes([number]) * (size // 8))
    one.link.close(AMPLE)
    for number in range(8):
        assert other.frames.get(timeout=AMPLE).body == bytes([number]) * (size // 8)
    assert other.reasons.get(timeout=AMPLE) == "the connection was closed by the other end"
    assert one.reasons.empty()
    other.link.close()


def test_each_end_learns_how_far_the_other_clock_is_ahead():
    client, server = pair()
    one, other = End(client), End(server, clock=lambda: time.monotonic_ns() + 5 * 10**12)
    until = time.monotonic() + AMPLE
    while min(end.link.offsets.count for end in (one, other)) < 5 and time.monotonic() < until:
        time.sleep(0.01)
    for end, ahead in ((one, 5 * 10**12), (other, -5 * 10**12)):
        estimate = end.link.offsets.estimate
        assert abs(estimate.value - ahead) <= estimate.uncertainty
        end.link.close()


def test_a_clock_that_jumps_ends_the_link_and_is_named():
    client, server = pair()
    jump = [0]
    one, other = End(client), End(server, clock=lambda: time.monotonic_ns() + jump[0])
    until = time.monotonic() + AMPLE
    while min(end.link.offsets.count for end in (one, other)) < 5 and time.monotonic() < until:
        time.sleep(0.01)
    jump[0] = 10**9  # far less than the silence that is borne
    reasons = [end.reasons.get(timeout=AMPLE) for end in (one, other)]
    # Whoever notices it first tells the other by closing.
    assert any("has jumped" in reason for reason in reasons), reasons
    one.link.close()
    other.link.close()


def test_the_other_end_that_closes_is_told_once_and_own_closing_is_not():
    one, other = map(End, pair())
    one.link.close()
    assert other.reasons.get(timeout=AMPLE) == "the connection was closed by the other end"
    assert not other.link.alive
    other.link.send(Kind.MESSAGE, b"goes nowhere")
    other.link.close()
    assert other.reasons.empty()
    assert one.reasons.empty()


def test_silence_ends_the_link():
    client, server = pair()
    one = End(client, silence=0.2)
    reason = one.reasons.get(timeout=AMPLE)
    assert reason.startswith("the other end has been silent for ")
    server.close()
    one.link.close()


@pytest.mark.parametrize("wrong", [b"GET / HTTP/1.1\r\n", frame(Kind.PING, b"short")])
def test_what_is_no_frame_ends_the_link(wrong):
    client, server = pair()
    one = End(client)
    server.sendall(wrong)
    assert "sends what is no frame of this protocol" in one.reasons.get(timeout=AMPLE)
    server.close()
    one.link.close()


def answer_late(running):
    """A link that hears something all the time, and after 80 s by its clock the answer to its first question."""
    client, server = pair()
    now = [0]
    one = End(client, silence=60.0, clock=lambda: now[0])
    one.link.watch(running)
    server.settimeout(AMPLE)
    head = server.recv(len(frame(Kind.PING, bytes(PING.size))), socket.MSG_WAITALL)
    assert head[4] == Kind.PING
    for _ in range(4):
        now[0] += 20 * 10**9
        server.sendall(frame(Kind.MESSAGE, b"old"))
        assert one.frames.get(timeout=AMPLE).body == b"old"
    server.sendall(frame(Kind.PONG, PONG.pack(0, 0, 0)) + frame(Kind.MESSAGE, b"after"))
    return one, server


def test_an_answer_that_is_too_late_ends_the_link_though_there_was_no_silence():
    one, server = answer_late(True)
    reason = one.reasons.get(timeout=AMPLE)
    assert reason.startswith("a question and its answer took 80000 ms, and 60000 ms is the limit")
    server.close()
    one.link.close()


def test_while_nothing_runs_an_answer_may_be_late():
    one, server = answer_late(False)
    assert one.frames.get(timeout=AMPLE).body == b"after"
    assert one.link.alive
    server.close()
    one.link.close()


def test_silence_is_borne_while_nothing_runs():
    client, server = pair()
    one = End(client, silence=0.1)
    one.link.watch(False)
    time.sleep(0.4)
    assert one.link.alive
    one.link.watch(True)
    assert "silent" in one.reasons.get(timeout=AMPLE)
    server.close()
    one.link.close()
