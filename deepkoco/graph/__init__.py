"""Nodes, delays, timing and execution of robot simulations, and recordings of what happened."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from deepkoco.graph.delay import (
    Autoregressive,
    Delay,
    DelayError,
    Deterministic,
    Empirical,
    Gamma,
    Gaussian,
    LogNormal,
    Lossy,
    Mixture,
    OrnsteinUhlenbeck,
    OverrunProcess,
    RankCorrelation,
    RecordedDelays,
    Stalls,
    Uniform,
    make_delay,
)
from deepkoco.graph.episodes.episode import Episode, Note, common_part, record_episodes, replay_episode
from deepkoco.graph.execution.runtime import BatchedRuntime, HorizonError, RuntimeState
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.contract import StepError
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import GraphError, Input, Node, Supervisor
from deepkoco.graph.timing.computation_graph import ComputationGraph
from deepkoco.graph.timing.draw import TimingError, draw_timing, extend_timing
from deepkoco.graph.timing.replay import MeasuredTiming, replay_timing

if TYPE_CHECKING:
    from deepkoco.graph.episodes.storage import (
        EpisodeFileError,
        EpisodeWriter,
        RecordedRun,
        read_episodes,
        write_episodes,
    )
    from deepkoco.graph.live import ConcurrentRuntime, NodeFailure, SimulatedRuntime, WallClockRuntime
    from deepkoco.logs.recording import LogError, Recording, Series, read_log, write_log

# Imported when they are asked for: recordings need pandas, which takes longer to import than a graph to start,
# and a batch of environments needs none of the runtimes for one.
_LATER = {
    **dict.fromkeys(("ConcurrentRuntime", "NodeFailure", "SimulatedRuntime", "WallClockRuntime"), "realtime"),
    **dict.fromkeys(("LogError", "Recording", "Series", "read_log", "write_log"), "recording"),
    **dict.fromkeys(("EpisodeFileError", "EpisodeWriter", "RecordedRun"), "storage"),
    **dict.fromkeys(("read_episodes", "write_episodes"), "storage"),
}
# Modules that a plain `import deepkoco.graph` is enough for.
_MODULES = frozenset(
    (
        "cuda",
        "derivative",
        "log_checks",
        "log_files",
        "log_series",
        "realtime",
        "recording",
        "sidecar",
        "storage",
        "units",
    )
)


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_LATER[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LATER, *_MODULES})


__all__ = [
    "Autoregressive",
    "BatchedRuntime",
    "ComputationGraph",
    "ConcurrentRuntime",
    "Connection",
    "Delay",
    "DelayError",
    "Deterministic",
    "Empirical",
    "Episode",
    "EpisodeFileError",
    "EpisodeWriter",
    "Gamma",
    "Gaussian",
    "Graph",
    "GraphError",
    "HorizonError",
    "Input",
    "LogError",
    "LogNormal",
    "Lossy",
    "MeasuredTiming",
    "Mixture",
    "Node",
    "NodeFailure",
    "Note",
    "OrnsteinUhlenbeck",
    "OverrunProcess",
    "RankCorrelation",
    "RecordedDelays",
    "RecordedRun",
    "Recording",
    "RuntimeState",
    "Series",
    "SimulatedRuntime",
    "Stalls",
    "StepError",
    "Supervisor",
    "TimingError",
    "Uniform",
    "WallClockRuntime",
    "common_part",
    "draw_timing",
    "extend_timing",
    "make_delay",
    "read_episodes",
    "read_log",
    "record_episodes",
    "replay_episode",
    "replay_timing",
    "write_episodes",
    "write_log",
]
