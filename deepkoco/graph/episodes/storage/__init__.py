"""Recordings on disk: episodes of every runtime in MCAP files, streamed and read back exactly."""

from deepkoco.graph.episodes.storage.container import EpisodeFileError
from deepkoco.graph.episodes.storage.description import RecordedNode, describe_graph, graph_from_description
from deepkoco.graph.episodes.storage.episode_writer import EpisodeWriter
from deepkoco.graph.episodes.storage.read import RecordedRun, read_episodes
from deepkoco.graph.episodes.storage.write import write_episodes
from deepkoco.old_names import moved_names

__all__ = [
    "EpisodeFileError",
    "EpisodeWriter",
    "RecordedNode",
    "RecordedRun",
    "describe_graph",
    "graph_from_description",
    "read_episodes",
    "write_episodes",
]

__getattr__ = moved_names(__name__)
