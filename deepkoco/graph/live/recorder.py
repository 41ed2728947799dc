"""The recorder: writes an episode down while its nodes run in threads and processes."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from multiprocessing.connection import Connection as Pipe
from multiprocessing.connection import wait
from pathlib import Path
from threading import Lock, Thread
from typing import Any

import numpy as np

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.episodes.storage.container import EpisodeFileError, check_target
from deepkoco.graph.episodes.storage.episode_writer import EpisodeWriter
from deepkoco.graph.live.driver import Driver
from deepkoco.graph.live.failure import Ending
from deepkoco.graph.live.plan import NodePlan, Plan
from deepkoco.graph.live.reporter import REPORT_PERIOD, Report, reports_of
from deepkoco.graph.model.graph import Graph

Record = bool | str | Path | EpisodeWriter
Drivers = Callable[[], Sequence[tuple[int, Driver | None]]]
NANO = 1e9


class Recorder:
    """Feeds a writer with what the nodes report, in a thread of its own.

    The nodes never wait for it. What it has not heard of when an episode ends it takes from the episode; where
    there is none, because a process died with its record, what was reported remains.

    Args:
        graph: what runs.
        target: file to write (`.mcap`), or the writer to feed, which stays open.
        meta: JSON object about the recording, for a file of its own.

    Raises:
        EpisodeFileError: the file cannot be written there, or the writer is one for another graph.
    """

    def __init__(
        self, graph: Graph, target: str | Path | EpisodeWriter, meta: Mapping[str, Any] | None = None
    ) -> None:
        self._graph, self._target, self._meta = graph, target, meta
        if not isinstance(target, EpisodeWriter):
            check_target(Path(target))
        elif target.graph is not graph:
            raise EpisodeFileError(
                f"{target.path}: the writer was made for another graph than the one that runs"
            )
        self._writer: EpisodeWriter | None = None
        self._lock = Lock()
        self._episode: int | None = None  # the one that is being written
        self._failure: EpisodeFileError | None = None
        self._thread: Thread | None = None
        self._ended = False

    def open(self) -> None:
        """Open the file, unless it is.

        Raises:
            EpisodeFileError: it exists.
        """
        if self._writer is None:
            target = self._target
            own = not isinstance(target, EpisodeWriter)
            self._writer = EpisodeWriter(target, self._graph, self._meta) if own else target

    def listen(self, reports: Sequence[Pipe], drivers: Drivers) -> None:
        """Start the thread.

        Args:
            reports: one pipe for each process, which is closed at the end.
            drivers: gives those of the caller's process.
        """
        self._ended = False
        self._thread = Thread(target=self._run, args=(list(reports), drivers), name="recorder", daemon=True)
        self._thread.start()

    def begin(
        self, number: int, plan: Plan | None, parts: Mapping[str, NodePlan], origin_ns: int | None
    ) -> None:
        """Begin an episode.

        Args:
            number: of the reset.
            plan: when things happen; None: the reports tell.
            parts: by node name, its part of the plan.
            origin_ns: time of day of t = 0 [ns since 1970], where there is one.
        """
        assert self._writer is not None
        with self._lock:
            self._plan, self._parts = plan, parts
            self._steps = dict.fromkeys(self._graph.index, 0)
            self._arrived: dict[str, set[int]] = {c.key: set() for c in self._graph.connections}
            self._writer.begin(origin_ns)
            self._episode = number

    def end(self, episode: Episode) -> None:
        """Write what is missing of an episode that is known by now, and how far it goes."""
        with self._lock:
            if self._episode is None:
                return
            self._guard(lambda: self._complete(episode))
            self._episode = None

    def close(self, episode: Episode | None, ending: Ending | None) -> None:
        """End the thread and, where it is the recorder's own, the file.

        Args:
            episode: the one that is being written, if it could be put together.
            ending: what ended the episode before its time; where there is no `episode` it is written down alone.

        Raises:
            EpisodeFileError: something could not be written.
        """
        self._ended = True
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if episode is not None:
            self.end(episode)
        elif ending is not None and self._episode is not None:
            self._guard(partial(self._write_ending, ending))
        self._episode = None
        writer, self._writer = self._writer, None
        failure, self._failure = self._failure, None
        if writer is not None and writer is not self._target:
            writer.close()
        if failure is not None:
            raise failure

    def _run(self, pipes: list[Pipe], drivers: Drivers) -> None:
        open_, last = list(pipes), False
        while not last:
            last = self._ended  # what was reported before is still read
            for source in wait(open_, 0.0 if last else REPORT_PERIOD):
                assert isinstance(source, Pipe)
                try:
                    while source.poll():
                        self._take(source.recv())
                except (EOFError, OSError):
                    open_.remove(source)
            for report in reports_of(drivers()):
                self._take(report)
        for pipe in pipes:
            pipe.close()

    def _take(self, report: Report) -> None:
        with self._lock:
            # The rest of an episode that has ended is known from elsewhere.
            if report.episode == self._episode:
                name = self._graph.nodes[report.position].name
                self._guard(lambda: self._write(name, report.news))

    def _guard(self, write: Callable[[], None]) -> None:
        """Write; if the disk fails, the run goes on and `close` tells."""
        try:
            write()
        except EpisodeFileError as error:
            self._failure = self._failure or error
            self._episode = None

    def _write(self, name: str, news: Mapping[str, Any]) -> None:
        assert self._writer is not None
        first, outputs = news["first"], news["outputs"]
        last = first + len(outputs)
        keys = [connection.key for connection in self._graph.inputs_of(name)]
        if self._plan is None:
            start, end = news["t_start"] / NANO, news["t_end"] / NANO
            for k in range(len(outputs)):
                windows = {key: seen[k] for key, seen in zip(keys, news["windows"], strict=True)}
                self._writer.step(name, first + k, start[k], end[k], outputs[k], windows)
            for key, arrivals in zip(keys, news["received"], strict=True):
                for seq, sent, received in arrivals.tolist():
                    self._message(key, seq, sent / NANO, received / NANO)
        else:
            end = np.zeros(len(outputs))
            for k, output in enumerate(outputs):
                step = self._parts[name].step(first + k)
                windows = {key: seen.seq for key, seen in zip(keys, step.windows, strict=True)}
                end[k] = step.t_end
                self._writer.step(name, first + k, step.t_start, step.t_end, output, windows)
            for connection in self._graph.connections:
                if connection.sender == name:
                    arrivals = self._plan.arrivals(connection, first, last).tolist()
                    for k, received in enumerate(arrivals):
                        self._message(connection.key, first + k, end[k], received)
        self._steps[name] = last

    def _message(self, key: str, seq: int, sent: float, received: float) -> None:
        assert self._writer is not None
        self._writer.message(key, seq, sent, received)
        self._arrived[key].add(seq)

    def _write_ending(self, ending: Ending) -> None:
        assert self._writer is not None
        note = ending.note
        if ending.failure:
            self._writer.fail(note.t, ending.failure, note.node)
        else:
            self._writer.note(note.t, note.text, note.level, note.node)

    def _complete(self, episode: Episode) -> None:
        assert self._writer is not None
        for name in self._graph.index:
            start, end = episode.t_start[name].tolist(), episode.t_end[name].tolist()
            outputs = episode.outputs.get(name, ())
            keys = [connection.key for connection in self._graph.inputs_of(name)]
            for k in range(self._steps[name], len(start)):
                windows = {key: episode.windows[key][k] for key in keys}
                output = outputs[k] if k < len(outputs) else None
                self._writer.step(name, k, start[k], end[k], output, windows)
        for key, arrived in self._arrived.items():
            times = zip(episode.t_sent[key].tolist(), episode.t_received[key].tolist(), strict=True)
            for seq, (sent, received) in enumerate(times):
                if seq not in arrived:
                    self._message(key, seq, sent, received)
        for note in episode.notes:
            self._writer.note(note.t, note.text, note.level, note.node)
        self._writer.end(episode)
