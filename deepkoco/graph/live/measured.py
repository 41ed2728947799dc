"""Measured episodes: what really ran, and how well the schedule was kept."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deepkoco.graph.episodes.episode import Episode, Note
from deepkoco.graph.model.graph import Graph


def measured_episode(graph: Graph, logs: Mapping[str, Mapping[str, Any]]) -> Episode:
    """Put the nodes' records together, cut at the supervisor's last start.

    A message that had not arrived when the episode ended has t_received infinity.

    Args:
        graph: what ran.
        logs: by node name, what its driver logged: `t_start`, `t_end` [ns] and `outputs` of its steps; per
            input `windows` and `received` (seq, sending, arrival [ns]).
    """
    acted = logs[graph.supervisor]["t_start"]
    for name, log in logs.items():
        # A step that failed or was cut off has a start and no end: the episode ends before it.
        if name != graph.supervisor and len(log["t_start"]) > len(log["t_end"]):
            acted = acted[acted < log["t_start"][len(log["t_end"])]]
    if not len(acted):
        raise ValueError("the episode failed before the supervisor's first step: there is nothing to keep")
    cut = acted[-1]
    t_start, t_end, outputs, sent, received, windows = {}, {}, {}, {}, {}, {}
    for node in graph.nodes:
        log = logs[node.name]
        count = int(np.searchsorted(log["t_start"], cut, side="right"))
        t_start[node.name] = log["t_start"][:count] / 1e9
        ends = log["t_end"][:count]
        if node.name == graph.supervisor:
            # Its last step only starts.
            count -= 1
            ends = np.append(ends[:count], cut)
        t_end[node.name] = ends / 1e9
        if count:
            outputs[node.name] = log["outputs"][:count]
    for connection in graph.connections:
        log = logs[connection.receiver]
        place = graph.inputs_of(connection.receiver).index(connection)
        count = len(outputs.get(connection.sender, ()))
        sent[connection.key] = t_end[connection.sender][:count]
        arrival = np.full(count, np.inf)
        seq, _, times = log["received"][place].T
        arrival[seq[seq < count]] = times[seq < count] / 1e9
        received[connection.key] = arrival
        windows[connection.key] = log["windows"][place][: len(t_start[connection.receiver])]
    episode = Episode(t_start, t_end, outputs, sent, received, windows)
    return replace(episode, notes=_notes(graph, episode))


def part_of_episode(graph: Graph, logs: Mapping[str, Mapping[str, Any]]) -> Episode:
    """Put the records of some of the nodes together, as far as they go; the others have no steps.

    Args:
        graph: what ran.
        logs: as for `measured_episode`, of the nodes whose records there are.

    Returns:
        All steps that ended, and of the connections into these nodes the messages that came, up to the first that
        did not.
    """
    none = np.zeros(0)
    t_start, t_end = {node.name: none for node in graph.nodes}, {node.name: none for node in graph.nodes}
    sent, received = {c.key: none for c in graph.connections}, {c.key: none for c in graph.connections}
    outputs, windows = {}, {c.key: np.zeros((0, c.window), np.int32) for c in graph.connections}
    for name, log in logs.items():
        ended, begun = len(log["t_end"]), len(log["t_start"])
        # Of the supervisor the last step only starts.
        kept = begun if name == graph.supervisor else ended
        t_start[name] = log["t_start"][:kept] / 1e9
        t_end[name] = np.concatenate([log["t_end"], log["t_start"][ended:]])[:kept] / 1e9
        if ended:
            outputs[name] = log["outputs"][:ended]
        for place, connection in enumerate(graph.inputs_of(name)):
            seq, t_sent, t_received = log["received"][place][np.argsort(log["received"][place][:, 0])].T
            whole = int((seq == np.arange(len(seq))).sum())
            sent[connection.key] = t_sent[:whole] / 1e9
            received[connection.key] = t_received[:whole] / 1e9
            windows[connection.key] = log["windows"][place][:kept]
    return Episode(t_start, t_end, outputs, sent, received, windows)


def _notes(graph: Graph, episode: Episode) -> tuple[Note, ...]:
    """Remark on what went wrong: overruns by node, lost messages by connection."""
    notes = []
    for node in graph.nodes:
        times = node_times(graph, episode, node.name)
        if times.overruns:
            worst = int(times.computation.argmax())
            text = (
                f"{times.overruns} of {times.steps} steps took longer than a period; the longest, "
                f"{times.computation[worst] * 1e3:.1f} ms, at tick {worst}"
            )
            notes.append(Note(float(episode.t_start[node.name][worst]), "warning", node.name, text))
    for connection in graph.connections:
        lost = message_times(graph, episode, connection.key).lost
        if lost:
            end = float(episode.t_start[graph.supervisor][-1])
            text = f"{lost} messages of {connection.key} did not arrive"
            notes.append(Note(end, "warning", connection.receiver, text))
    return tuple(notes)


@dataclass(frozen=True)
class NodeTimes:
    """How one node kept its schedule.

    Attributes:
        steps: steps that it ran, one for each tick.
        lateness: (K,) start after the nominal tick [s]; after own overruns with frequency scheduling, after
            the tick that they have shifted.
        period: (K - 1,) from one start to the next [s].
        computation: (K,) duration of the steps [s]; for the supervisor from its start to the action.
        overruns: steps that took longer than a period.
    """

    steps: int
    lateness: np.ndarray
    period: np.ndarray
    computation: np.ndarray
    overruns: int


@dataclass(frozen=True)
class MessageTimes:
    """What became of one connection's messages.

    Attributes:
        sent: messages sent.
        lost: messages that had not arrived at the end, those of the last period not counted.
        unseen: messages that arrived and that no step saw, because newer ones had come since.
        delay: (n,) from sending to arrival [s].
    """

    sent: int
    lost: int
    unseen: int
    delay: np.ndarray


def node_times(graph: Graph, episode: Episode, name: str) -> NodeTimes:
    """Compare a node's starts with its nominal ticks."""
    node, start = graph.node(name), episode.t_start[name]
    period = float(1 / node.rate)
    computation = episode.t_end[name] - start
    if name == graph.supervisor:
        computation = computation[:-1]
    nominal = float(graph.phases[graph.index[name]]) + np.arange(len(start)) * period
    if node.scheduling == "frequency":
        over = np.maximum(computation - period, 0.0)
        nominal = nominal + np.concatenate([[0.0], np.cumsum(over)])[: len(start)]
    return NodeTimes(
        steps=len(start),
        lateness=start - nominal,
        period=np.diff(start),
        computation=computation,
        overruns=int((computation > period).sum()),
    )


def message_times(graph: Graph, episode: Episode, key: str) -> MessageTimes:
    """Follow the messages of a connection."""
    connection = next(c for c in graph.connections if c.key == key)
    sent, received = episode.t_sent[key], episode.t_received[key]
    arrived = np.isfinite(received)
    # What was under way when the episode ended is not lost.
    end = episode.t_start[graph.supervisor][-1]
    old = sent < end - float(1 / graph.node(connection.sender).rate)
    seen = np.unique(episode.windows[key])
    last = seen.max(initial=-1)
    passed = np.flatnonzero(arrived)
    return MessageTimes(
        sent=len(sent),
        lost=int((~arrived & old).sum()),
        unseen=int(((passed < last) & ~np.isin(passed, seen)).sum()),
        delay=received[arrived] - sent[arrived],
    )
