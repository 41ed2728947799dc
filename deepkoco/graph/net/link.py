"""The link: a connection that shows that it lives, knows the other clock, and never makes a sender wait."""

import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from deepkoco.graph.net.clock_offset import ClockJumpError, Exchange, Offset, OffsetEstimator
from deepkoco.graph.net.wire import PING, PONG, Frame, FrameReader, Kind, Ping, Pong, WireError, frame

BEAT_PERIOD = 0.02  # from one sign of life to the next [s]
SILENCE = 0.06
"""Longest time without anything from the other end [s]; what has to be safe within 100 ms needs the rest to stop."""
IDLE_SILENCE = 5.0
"""The same while no episode runs and all is at rest: long records are packed then, and modules imported [s]."""
_MOST = 1 << 16  # bytes taken from the socket at once


@dataclass
class LinkCounts:
    """What went over a link.

    Attributes:
        frames_sent, frames_received: of all kinds.
        bytes_sent, bytes_received: with their heads.
        longest_silence: [s].
    """

    frames_sent: int = 0
    frames_received: int = 0
    bytes_sent: int = 0
    bytes_received: int = 0
    longest_silence: float = 0.0


class Link:
    """One end of the connection, served by a thread of its own.

    What is sent goes out at once as far as the system takes it, and the rest when it can. A network that takes nothing
    for as long as `silence` has failed like one that brings nothing, and so has one that needs longer than that for a
    question and its answer: what comes over it all the time is old.

    Args:
        connection: connected; greeted when the link starts.
        take: is given what comes, other than signs of life, in the link's thread.
        lost: is told once why the link has ended, unless `close` ended it.
        silence: longest time without anything from the other end while an episode runs [s].
        clock: own time [ns, monotonic].
        exchanged: is given each estimate of the other clock, with the own time [ns].
        known: correction and uncertainty [ns] of this end's clock, for the other end; None: this end leads.
    """

    def __init__(
        self,
        connection: socket.socket,
        take: Callable[[Frame], None],
        lost: Callable[[str], None],
        silence: float = SILENCE,
        clock: Callable[[], int] = time.monotonic_ns,
        exchanged: Callable[[Offset, int], None] | None = None,
        known: Callable[[], tuple[int, int]] | None = None,
    ) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.counts, self.offsets = LinkCounts(), OffsetEstimator()
        self.far_correction = (0, 0)
        """What the other end says of its clock: correction and uncertainty [ns]."""
        self.exchanges: list[Exchange] | None = None
        """Where it is a list, all exchanges are kept in it."""
        self._connection, self._take, self._lost = connection, take, lost
        self._limits = max(silence, IDLE_SILENCE), silence
        self._silence, self._clock, self._exchanged, self._known = self._limits[0], clock, exchanged, known
        self._reader, self._pending, self._lock = FrameReader(), bytearray(), threading.Lock()
        self._taken = clock()  # when the system last took all or some of what was pending [ns]
        self._heard = self._taken  # when something last came [ns]
        self._parting = False  # nothing more goes out
        self._watched: int | None = None  # since when an episode runs [ns]
        self._looked = self._looked_before = self._taken  # the last looks at what has come [ns]
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)

    def start(self) -> None:
        """Begin to listen and to show that this end lives."""
        self._connection.setblocking(False)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether it has neither failed nor been closed."""
        return not self._closed.is_set()

    def watch(self, running: bool) -> None:
        """Say whether an episode runs, so that silence counts."""
        if not running:
            self._watched = None
        elif self._watched is None:
            self._watched = self._clock()
        self._silence = self._limits[running]

    def send(self, kind: Kind, body: bytes) -> None:
        """Send a frame; where the link has ended it goes nowhere."""
        whole = frame(kind, body)
        with self._lock:
            if self._closed.is_set() or self._parting:
                return
            if not self._pending:
                self._taken = self._clock()
            self._pending += whole
            self.counts.frames_sent += 1
            self._flush()

    def close(self, patience: float = 0.0) -> None:
        """End the link; safe to call twice.

        A connection that is closed with something unread is reset, and what is on its way to the other end is lost. So
        this end first says that nothing more comes, and reads until the other end has closed.

        Args:
            patience: how long the network may take nothing, and then the other end may stay silent [s].
        """
        since, own = self._clock(), threading.current_thread() is self._thread
        while (
            self._pending
            and not self._closed.is_set()
            and self._since(max(since, self._taken)) < 1e3 * patience
        ):
            time.sleep(0.001)
        with self._lock:
            parts = not (own or self._pending or self._closed.is_set() or self._parting)
            self._parting = True
        if parts and patience > 0.0 and self._thread.ident is not None:
            with suppress(OSError):
                self._connection.shutdown(socket.SHUT_WR)
            since = self._clock()
            while not self._closed.is_set() and self._since(max(since, self._heard)) < 1e3 * patience:
                time.sleep(0.001)
        self._closed.set()
        if not own and self._thread.ident is not None:
            self._thread.join()
        with self._lock:
            self._connection.close()

    def _flush(self) -> None:
        """Give the system what it takes; of a connection that is broken the reading side hears."""
        try:
            while self._pending:
                sent = self._connection.send(self._pending)
                del self._pending[:sent]
                self.counts.bytes_sent += sent
                self._taken = self._clock()
        except OSError:
            return

    def _run(self) -> None:
        try:
            reason = self._serve()
        except ClockJumpError as error:
            reason = str(error)
        except WireError as error:
            reason = f"the other end sends what is no frame of this protocol ({error})"
        except (ConnectionResetError, BrokenPipeError):
            reason = None  # it was closed with something unread
        except OSError as error:
            reason = f"the connection is broken ({error.strerror or error})"
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
        if not self._closed.is_set():
            self._closed.set()
            with suppress(OSError):
                self._connection.shutdown(socket.SHUT_RDWR)  # the other end is to hear of it at once
            if self._parting:
                return  # the other end has closed, as it was asked to
            self._lost(reason or "the connection was closed by the other end")

    def _serve(self) -> str | None:
        """Listen until the end; return why it ended, None where the other end has closed."""
        heard = beat = self._clock()
        while not self._closed.is_set():
            now, silence = self._clock(), round(self._silence * 1e9)
            if now >= beat:
                self._ping(now)
                beat = now + round(BEAT_PERIOD * 1e9)
            wait = max(0.0, (min(beat, heard + silence) - now) / 1e9)
            writing = [self._connection] if self._pending else []
            readable, writable, _ = select.select([self._connection], writing, [], wait)
            self._looked_before, self._looked = self._looked, self._clock()
            if writable:
                with self._lock:
                    self._flush()
            if not readable and self._clock() > heard + silence:
                # It may be this end that slept: look before another is blamed.
                readable, _, _ = select.select([self._connection], [], [], 0.0)
                if not readable:
                    return f"the other end has been silent for {self._since(heard)} ms"
            if readable:
                if not (data := self._connection.recv(_MOST)):
                    return None
                now = self._clock()
                self.counts.longest_silence = max(self.counts.longest_silence, (now - heard) / 1e9)
                self._heard = heard = now
                self.counts.bytes_received += len(data)
                for one in self._reader.feed(data):
                    self.counts.frames_received += 1
                    if (late := self._sort(one, now)) is not None:
                        return late
            elif self._pending and self._clock() > self._taken + silence:
                return f"the network has taken nothing for {self._since(self._taken)} ms"
        return None

    def _since(self, instant: int) -> int:
        return round((self._clock() - instant) / 1e6)

    def _sort(self, one: Frame, now: int) -> str | None:
        """Take a frame; return why the link must end, if it must."""
        if one.kind == Kind.PING and len(one.body) == PING.size:
            ping = Ping(*PING.unpack(one.body))
            self.far_correction = ping.correction, ping.uncertainty
            self.send(Kind.PONG, PONG.pack(ping.sent, now, self._clock()))
        elif one.kind == Kind.PONG and len(one.body) == PONG.size:
            pong = Pong(*PONG.unpack(one.body))
            if (late := self._too_late(pong)) is not None:
                return late
            exchange = Exchange(*pong, now)
            if self.exchanges is not None:
                self.exchanges.append(exchange)
            estimate = self.offsets.add(exchange)
            if self._exchanged is not None:
                self._exchanged(estimate, now)
        elif one.kind in (Kind.PING, Kind.PONG):
            raise WireError(f"{Kind(one.kind).name} of {len(one.body)} bytes")
        else:
            self._take(one)
        return None

    def _too_late(self, pong: Pong) -> str | None:
        """Return what is wrong with the age of an answer while an episode runs; None where nothing is."""
        watched = self._watched
        if watched is None:
            return None  # a long record may be on its way
        # It was not there at the look before this one; where this end slept since, nobody else is blamed.
        took = self._looked_before - max(pong.sent, watched)
        if took <= self._silence * 1e9:
            return None
        return (
            f"a question and its answer took {took / 1e6:.0f} ms, and {self._silence * 1e3:.0f} ms is the limit: what "
            "comes is old (a network slower than what goes over it)"
        )

    def _ping(self, now: int) -> None:
        correction, uncertainty = (0, 0) if self._known is None else self._known()
        self.send(Kind.PING, PING.pack(self._clock(), correction, uncertainty))
