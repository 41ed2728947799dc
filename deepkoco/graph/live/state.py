"""The state that the runtimes of one environment hand out, and the episode that they keep."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.execution.runtime import HorizonError
from deepkoco.graph.live.plan import Plan
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Input

Policy = Callable[[dict[str, Input]], Tensor]


@dataclass(frozen=True, eq=False)
class RunningState:
    """Where an environment that runs elsewhere stands: between two actions of the supervisor.

    It reads like the batched runtime's state, for one environment; but what runs cannot be copied, so
    only the latest one can be stepped.

    Attributes:
        step: (1,) int64, supervisor step that waits for its action.
        time: (1,) float64, start of that step [s].
        steps_left: (1,) int64, actions that can still be taken.
        readings: what the supervisor's `observe` returned, (1, ...) by name.
    """

    step: np.ndarray
    time: np.ndarray
    steps_left: np.ndarray
    readings: dict[str, Tensor]


def running_state(step: int, time: float, steps: int | None, readings: dict[str, Tensor]) -> RunningState:
    """Wrap plain numbers; `steps` None: without end."""
    left = np.iinfo(np.int64).max if steps is None else steps - step
    return RunningState(
        np.array([step], dtype=np.int64), np.array([time]), np.array([left], dtype=np.int64), readings
    )


def check_step(running: RunningState | None, state: RunningState) -> None:
    """Refuse to step an old state, or beyond the end.

    Raises:
        ValueError: the state is not the latest one.
        HorizonError: the timing ends here.
    """
    if running is None:
        raise ValueError("step before reset: call reset first")
    if state is not running:
        raise ValueError("this state has been stepped already; what runs cannot be set back, only reset")
    if state.steps_left[0] <= 0:
        raise HorizonError(
            f"the environment has taken all {int(state.step[0])} supervisor steps of its timing; "
            "draw a longer one or reset it"
        )


def planned_episode(
    graph: Graph, plan: Plan, step: int, outputs: Mapping[str, Sequence[np.ndarray]]
) -> Episode:
    """Put together what ran before a supervisor step by a plan.

    Args:
        graph: what ran.
        plan: when it ran.
        step: the supervisor step that ends the episode.
        outputs: by node name, at least the outputs before that step, each without the batch.
    """
    t_start, t_end, windows, sent, received = {}, {}, {}, {}, {}
    counts = {}
    for node in graph.nodes:
        part = plan.of(node.name)
        own = node.name == graph.supervisor
        counts[node.name] = step if own else part.limit(step)
        steps = [part.step(k) for k in range(counts[node.name] + own)]
        t_start[node.name] = np.array([s.t_start for s in steps], dtype=np.float64)
        t_end[node.name] = np.array([s.t_end for s in steps], dtype=np.float64)
        for place, connection in enumerate(graph.inputs_of(node.name)):
            seen = [s.windows[place].seq for s in steps]
            windows[connection.key] = np.array(seen, dtype=np.int32).reshape(-1, connection.window)
    for connection in graph.connections:
        count = counts[connection.sender]
        sent[connection.key] = t_end[connection.sender][:count]
        received[connection.key] = plan.arrivals(connection, 0, count)
    kept = {name: np.stack(values[: counts[name]]) for name, values in outputs.items() if counts[name]}
    keys = [connection.key for connection in graph.connections]
    return Episode(t_start, t_end, kept, sent, received, windows={key: windows[key] for key in keys})
