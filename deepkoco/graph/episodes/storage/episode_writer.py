"""The writer: streams episodes to disk while a run goes on."""

from __future__ import annotations

import contextlib
import math
import queue
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from torch import Tensor

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.episodes.storage.container import (
    Container,
    EpisodeFileError,
    check_target,
    extent_of,
    index_journal,
    json_object,
)
from deepkoco.graph.episodes.storage.messages import LEVELS
from deepkoco.graph.model.graph import Graph
from deepkoco.output.whole_file import WriteError, writing

_BATCH = 4096  # messages that go to the file in one write
_MOST_WAITING = 200_000  # messages in memory before a sender is slowed down


class EpisodeWriter:
    """Records episodes of a graph as they happen; any thread may call it, none waits for the disk.

    While it is open the messages stand one by one in `NAME.mcap.partial`, so that whatever stops the
    program, all messages up to the last few milliseconds can be read (`read_episodes(..., partial=True)`).
    `close` turns that file into `NAME.mcap`, compressed and indexed.

    Times are seconds since the episode began, float64, and come back exactly. Steps of a node are
    numbered from 0; steps, messages and nodes may come in any order.

    Args:
        path: file to write, `.mcap`; must not exist.
        graph: what runs.
        meta: JSON object about the whole recording.
        origin_ns: time of day of t = 0 of the first episode [ns since 1970], where there is one.

    Raises:
        EpisodeFileError: the file exists, its folder does not, or `meta` is no JSON.
        WriteError: the disk is full, or the place cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        graph: Graph,
        meta: Mapping[str, Any] | None = None,
        origin_ns: int | None = None,
    ) -> None:
        self.path = Path(path)
        self.journal = self.path.with_name(f"{self.path.name}.partial")
        self.graph = graph
        check_target(self.path)
        if self.journal.exists():
            raise EpisodeFileError(
                f"{self.journal}: left by a run that did not finish, or being written; read it with "
                "partial=True and move it away"
            )
        meta = json_object(self.path, meta)
        self._nodes = frozenset(graph.index)
        self._connections = {c.key: (c.receiver, c.window) for c in graph.connections}
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._begun, self._ended, self._closed = False, False, False
        self._failure: BaseException | None = None
        self._origin = origin_ns
        with writing(self.path, self.journal):
            self._file = self.journal.open("xb")
            try:
                self._container = Container(self._file, graph, meta, chunked=False)
                self._file.flush()
            except BaseException:
                _close(self._file)
                self.journal.unlink()
                raise
        self._thread = threading.Thread(target=self._work, name=f"writes {self.path.name}", daemon=True)
        self._thread.start()

    def begin(self, origin_ns: int | None = None, meta: Mapping[str, Any] | None = None) -> None:
        """Begin an episode; the first one begins by itself, and what is written from now on belongs to it.

        Args:
            origin_ns: time of day of its t = 0 [ns since 1970]; None shows it a second after the last one.
            meta: JSON object about this episode.
        """
        content = json_object(self.path, meta)
        with self._lock:
            self._begun, self._ended = True, False
            self._put(lambda: self._container.begin(origin_ns, content))

    def end(self, episode: Episode) -> None:
        """Cut the episode to the extent of one that is known by now: what was written beyond it does not count.

        A run that stops in the middle has written steps that came after its last common instant. Optional;
        an episode without it has all that was written.

        Args:
            episode: where nodes and connections end; the last step of the supervisor loses its output. If a failure
                ended it, that is recorded too.
        """
        extent = extent_of(self.graph, episode)
        self._record(lambda: self._container.end(extent))
        if episode.failure:
            self._record(lambda: self._container.fail(episode.failure))
        self._ended = True

    def fail(self, t: float, reason: str, node: str | None = None) -> None:
        """Record that a failure ended the episode: as a note of level "fatal", and as the episode's end.

        Args:
            t: when [s].
            reason: what happened.
            node: which node it is about.
        """
        self.note(t, reason, "fatal", node)
        self._record(lambda: self._container.fail(reason))
        self._ended = True

    def step(
        self,
        node: str,
        seq: int,
        t_start: float,
        t_end: float,
        output: np.ndarray | Tensor | None = None,
        windows: Mapping[str, Iterable[int]] | None = None,
    ) -> None:
        """Record a step that has ended.

        Args:
            node: its name.
            seq: its number in the episode, from 0.
            t_start, t_end: start and end [s].
            output: what it sent, (...) of one environment; None where it sent nothing (the last step of the
                supervisor). It is copied.
            windows: by connection key, the steps of the sender that it saw, oldest first.

        Raises:
            EpisodeFileError: the graph has no such node or connection, a time is not finite, the output is
                not numeric, or the disk failed.
        """
        if node not in self._nodes:
            raise self._wrong(f'"{node}" is no node; known: {", ".join(self.graph.index)}')
        where = f'step {seq} of node "{node}"'
        self._check_times(where, t_start, t_end)
        seen = {key: [int(i) for i in window] for key, window in (windows or {}).items()}
        for key, window in seen.items():
            if self._connections.get(key) != (node, len(window)):
                raise self._wrong(f'{where}: window {window} does not fit connection "{key}"')
        value = None
        if output is not None:
            value = np.array(output.detach().cpu().numpy() if isinstance(output, Tensor) else output)
            if value.dtype.kind not in "biufc":
                raise self._wrong(f"{where}: output of dtype {value.dtype} is not numeric")
        numbers = int(seq), float(t_start), float(t_end)
        self._record(lambda: self._container.step(node, *numbers, value, seen))

    def message(self, connection: str, seq: int, t_sent: float, t_received: float) -> None:
        """Record that a message has arrived.

        Args:
            connection: key of the connection.
            seq: step of the sender that sent it.
            t_sent, t_received: end of that step, arrival [s]; infinity: it never arrives, as `lost`.
        """
        if t_received == math.inf:
            return self.lost(connection, seq, t_sent)
        self._check_connection(connection)
        self._check_times(f'message {seq} of "{connection}"', t_sent, t_received)
        numbers = int(seq), float(t_sent), float(t_received)
        return self._record(lambda: self._container.message(connection, *numbers))

    def lost(self, connection: str, seq: int, t_sent: float) -> None:
        """Record that a message never arrives; arguments as for `message`."""
        self._check_connection(connection)
        self._check_times(f'message {seq} of "{connection}"', t_sent, t_sent)
        numbers = int(seq), float(t_sent)
        self._record(lambda: self._container.message(connection, *numbers, None))

    def note(self, t: float, text: str, level: str = "info", node: str | None = None) -> None:
        """Record a remark (an overrun, a missing heartbeat, a stop); viewers list it in their log panel.

        Args:
            t: when [s].
            text: what happened.
            level: "debug", "info", "warning", "error" or "fatal".
            node: which node it is about.
        """
        if level not in LEVELS:
            raise self._wrong(f'note of level "{level}"; known: {", ".join(LEVELS)}')
        self._check_times(f'note "{text}"', t, t)
        self._record(lambda: self._container.note(float(t), text, level, node))

    def close(self) -> None:
        """Write what is left and give the file its name; does nothing the second time.

        Raises:
            EpisodeFileError: the disk failed; what could be written is in the journal.
        """
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._queue.put(None)
        self._thread.join()
        try:
            if self._failure is None:
                self._container.finish()
                self._file.flush()
        except OSError as error:
            self._failure = error
        _close(self._file)
        self._raise_failure()
        try:
            index_journal(self.journal, self.path)
        except WriteError as error:
            raise EpisodeFileError(
                f"{error}; the whole recording is in {self.journal}, which can be read in its place"
            ) from error
        self.journal.unlink()

    def __enter__(self) -> EpisodeWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
            return
        # What was recorded before the mistake is worth keeping, and the mistake is what must be heard of.
        with contextlib.suppress(EpisodeFileError, OSError):
            if isinstance(error, Exception) and self._begun and not self._ended:
                reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
                self._record(lambda: self._container.fail(reason))
            self.close()

    def _record(self, write: Callable[[], None]) -> None:
        with self._lock:
            if not self._begun:
                self._begun = True
                origin = self._origin
                self._put(lambda: self._container.begin(origin, {}))
            self._put(write)
        while self._queue.qsize() > _MOST_WAITING and self._failure is None:
            time.sleep(0.001)

    def _put(self, write: Callable[[], None]) -> None:
        if self._closed:
            raise self._wrong("the writer is closed")
        self._raise_failure()
        self._queue.put(write)

    def _work(self) -> None:
        try:
            while True:
                batch = [self._queue.get()]
                while len(batch) < _BATCH and not self._queue.empty():
                    batch.append(self._queue.get())
                for write in batch:
                    if write is None:
                        return
                    write()
                self._file.flush()
        except BaseException as error:  # told to the threads that record, at their next call
            self._failure = error

    def _raise_failure(self) -> None:
        if self._failure is not None:
            reason = str(self._failure)
            if isinstance(self._failure, OSError):
                reason = str(WriteError(self.journal, self._failure))
            raise self._wrong(
                f"not written any further: {reason}; what could be written can be read with partial=True from "
                f"{self.journal}"
            ) from self._failure

    def _check_connection(self, connection: str) -> None:
        if connection not in self._connections:
            raise self._wrong(f'"{connection}" is no connection; known: {", ".join(self._connections)}')

    def _check_times(self, where: str, start: float, end: float) -> None:
        if not (math.isfinite(start) and math.isfinite(end)):
            raise self._wrong(f"{where}: times {start} s and {end} s are not both finite")

    def _wrong(self, text: str) -> EpisodeFileError:
        return EpisodeFileError(f"{self.path}: {text}")


def _close(file: IO[bytes]) -> None:
    """Close a file; the bytes that a full disk has refused already are no news."""
    with contextlib.suppress(OSError):
        file.close()
