"""Episodes: what ran when, what it sent, who used it; recorded from the runtime and replayed in it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.runtime import BatchedRuntime, NodeParameters, RuntimeState, Trace
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Input, State
from deepkoco.graph.timing.computation_graph import ComputationGraph
from deepkoco.graph.timing.replay import MeasuredTiming, replay_timing

_NEVER = np.iinfo(np.int64).max // 8  # ticks: an arrival after this is none
Policy = Callable[[Mapping[str, Input]], Tensor]


class Note(NamedTuple):
    """A remark about a run: when [s], "debug" to "fatal", about which node (empty: the run), what happened."""

    t: float
    level: str
    node: str
    text: str


@dataclass(frozen=True)
class Episode:
    """One environment's episode; times in seconds, float64.

    Attributes:
        t_start, t_end: by node name, (K,) of its K steps.
        outputs: by node name, (K, ...); the supervisor has one step more than outputs.
        t_sent, t_received: by connection key, (K,) of the sender's messages; a message that never arrived
            has t_received infinity.
        windows: by connection key, (K, window) seqs that each step of the receiver saw, oldest first;
            negative: the initial output. A connection is missing if its windows were not recorded.
        notes: remarks in the order in which they were made.
        failure: what ended the episode before its time; empty: nothing did.
    """

    t_start: dict[str, np.ndarray]
    t_end: dict[str, np.ndarray]
    outputs: dict[str, np.ndarray]
    t_sent: dict[str, np.ndarray]
    t_received: dict[str, np.ndarray]
    windows: dict[str, np.ndarray]
    notes: tuple[Note, ...] = ()
    failure: str = ""

    @property
    def measured(self) -> MeasuredTiming:
        """The times as they enter `replay_timing`."""
        return MeasuredTiming(self.t_start, self.t_end, self.t_received)


def record_episodes(
    runtime: BatchedRuntime,
    policy: Policy,
    parameters: NodeParameters,
    generator: torch.Generator,
    initial: Mapping[str, State] | None = None,
    timing: ComputationGraph | None = None,
) -> tuple[list[Episode], RuntimeState]:
    """Run the whole timing of a batch and record every step.

    Args:
        runtime: what runs the graph.
        policy: from what the supervisor sees to its actions (B, M).
        parameters, generator, initial, timing: as for `BatchedRuntime.reset`.

    Returns:
        One episode for each environment, and the last state.
    """
    trace: Trace = []
    state, inputs = runtime.reset(parameters, generator, initial, timing=timing, trace=trace)
    schedule = state.schedule.timing
    for _ in range(schedule.steps):
        state, inputs = runtime.step(state, policy(inputs), trace=trace)
    return [_episode(runtime.graph, schedule, trace, b) for b in range(schedule.batch)], state


def replay_episode(
    graph: Graph,
    episode: Episode,
    parameters: NodeParameters,
    generator: torch.Generator,
    initial: Mapping[str, State] | None = None,
) -> tuple[Episode, RuntimeState]:
    """Run an episode again: its times and windows instead of drawn delays, its actions instead of a policy.

    With the same parameters and initial state the outputs are the recorded ones, bit for bit; with
    others they show what another model would have done.
    """
    timing = replay_timing(graph, episode.measured, windows=windows_for(graph, episode))
    runtime = BatchedRuntime(graph, timing)
    actions = iter(torch.from_numpy(episode.outputs[graph.supervisor]))
    episodes, state = record_episodes(runtime, lambda _: next(actions)[None], parameters, generator, initial)
    return episodes[0], state


def windows_for(graph: Graph, episode: Episode) -> dict[str, np.ndarray]:
    """Choose the recorded windows that fit a graph, by connection key.

    A connection whose windows were not recorded or had another length is left out: what its receiver sees in a
    replay follows from the arrivals.
    """
    return {
        c.key: episode.windows[c.key]
        for c in graph.connections
        if c.key in episode.windows and episode.windows[c.key].shape[1:] == (c.window,)
    }


def common_part(graph: Graph, episode: Episode) -> Episode:
    """Cut an episode at the last start of the supervisor that all nodes have gone past.

    A recording that was cut off knows of some nodes more than of others. What is left of it is whole and replays.

    Args:
        graph: what ran.
        episode: of which some nodes may have run on.

    Raises:
        ValueError: a node did not get that far.
    """
    begun = {name: float(start[-1]) if len(start) else -np.inf for name, start in episode.t_start.items()}
    behind = min(begun, key=lambda name: begun[name])
    acts = episode.t_start[graph.supervisor]
    # Of a node that starts no later than the cut a further step may be missing.
    acted = (
        int(np.searchsorted(acts, begun[behind], side="right" if behind == graph.supervisor else "left")) - 1
    )
    if acted < 0:
        raise ValueError(f'node "{behind}" has no step after the first of "{graph.supervisor}"')
    count = {
        name: int(np.searchsorted(start, acts[acted], side="right"))
        for name, start in episode.t_start.items()
    }
    sent = count | {graph.supervisor: acted}
    _drop_what_saw_later(graph, episode, count, sent)
    senders = {connection.key: connection.sender for connection in graph.connections}
    receivers = {connection.key: connection.receiver for connection in graph.connections}
    return replace(
        episode,
        t_start={name: start[: count[name]] for name, start in episode.t_start.items()},
        t_end={name: end[: count[name]] for name, end in episode.t_end.items()},
        outputs={name: output[: sent[name]] for name, output in episode.outputs.items() if sent[name]},
        t_sent={key: time[: sent[senders[key]]] for key, time in episode.t_sent.items()},
        t_received={key: time[: sent[senders[key]]] for key, time in episode.t_received.items()},
        windows={key: seen[: count[receivers[key]]] for key, seen in episode.windows.items()},
    )


def _drop_what_saw_later(graph: Graph, episode: Episode, count: dict[str, int], sent: dict[str, int]) -> None:
    """Shorten `count` and `sent` by the steps that saw a message beyond `sent`.

    Without delay a node answers the supervisor at the very instant of the cut; that answer belongs to the
    step that is cut off.
    """
    changed = True
    while changed:
        changed = False
        for connection in graph.connections:
            receiver, first = connection.receiver, sent[connection.sender]
            if receiver == graph.supervisor or not count[receiver]:
                continue
            if connection.key in episode.windows:
                saw = episode.windows[connection.key][: count[receiver]].max(axis=1) >= first
            else:
                arrived = episode.t_received[connection.key][first:].min(initial=np.inf)
                # Whether a message that arrives at the start of a step is seen then, a jitter buffer decides too.
                saw = episode.t_start[receiver][: count[receiver]] >= arrived
            if saw.any():
                count[receiver] = sent[receiver] = int(np.argmax(saw))
                changed = True


def episode_of_timing(graph: Graph, timing: ComputationGraph, row: int = 0) -> Episode:
    """Return the times and windows of one schedule as an episode without outputs.

    Args:
        graph: what runs.
        timing: drawn or replayed.
        row: schedule.
    """

    def seconds(ticks: np.ndarray) -> np.ndarray:
        return np.where(ticks < _NEVER, ticks / timing.resolution, np.inf)

    steps = [timing.steps_of(n, row) for n in range(len(graph.nodes))]
    messages = [timing.messages_of(e, row) for e in range(len(graph.connections))]
    names, keys = list(graph.index), [connection.key for connection in graph.connections]
    return Episode(
        t_start={name: seconds(start) for name, (start, _) in zip(names, steps, strict=True)},
        t_end={name: seconds(end) for name, (_, end) in zip(names, steps, strict=True)},
        outputs={},
        t_sent={key: seconds(sent) for key, (sent, _) in zip(keys, messages, strict=True)},
        t_received={key: seconds(received) for key, (_, received) in zip(keys, messages, strict=True)},
        windows={key: timing.windows_of(e, row) for e, key in enumerate(keys)},
    )


def _episode(graph: Graph, timing: ComputationGraph, trace: Trace, environment: int) -> Episode:
    outputs: dict[str, list[np.ndarray]] = {node.name: [] for node in graph.nodes}
    for position, seq, output in trace:
        if seq[min(environment, len(seq) - 1)] >= 0:
            value = output[min(environment, len(output) - 1)]
            outputs[graph.nodes[position].name].append(value.detach().cpu().numpy())
    times = episode_of_timing(graph, timing, int(timing.row[environment]))
    stacked = {name: np.stack(values) for name, values in outputs.items() if values}
    return replace(times, outputs=stacked)
