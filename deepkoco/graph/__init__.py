"""Nodes, delays, timing and execution of robot simulations, and recordings of what happened."""

from deepkoco.graph.computation_graph import ComputationGraph
from deepkoco.graph.connection import Connection
from deepkoco.graph.delay import Delay, DelayError, Deterministic, Empirical, Gaussian, Mixture, make_delay
from deepkoco.graph.episode import Episode, Note, record_episodes, replay_episode
from deepkoco.graph.graph import Graph
from deepkoco.graph.node import GraphError, Input, Node, Supervisor
from deepkoco.graph.recording import LogError, Recording, Series, read_log, write_log
from deepkoco.graph.replay import MeasuredTiming, replay_timing
from deepkoco.graph.runtime import BatchedRuntime, HorizonError, RuntimeState
from deepkoco.graph.storage import EpisodeFileError, EpisodeWriter, RecordedRun, read_episodes, write_episodes
from deepkoco.graph.timing import TimingError, draw_timing, extend_timing

__all__ = [
    "BatchedRuntime",
    "ComputationGraph",
    "Connection",
    "Delay",
    "DelayError",
    "Deterministic",
    "Empirical",
    "Episode",
    "EpisodeFileError",
    "EpisodeWriter",
    "Gaussian",
    "Graph",
    "GraphError",
    "HorizonError",
    "Input",
    "LogError",
    "MeasuredTiming",
    "Mixture",
    "Node",
    "Note",
    "RecordedRun",
    "Recording",
    "RuntimeState",
    "Series",
    "Supervisor",
    "TimingError",
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
