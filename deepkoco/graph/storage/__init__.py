"""Recordings on disk: episodes of every runtime in MCAP files, streamed, read back exactly, exported."""

from deepkoco.graph.storage.container import EpisodeFileError
from deepkoco.graph.storage.description import RecordedNode, describe_graph, graph_from_description
from deepkoco.graph.storage.episode_writer import EpisodeWriter
from deepkoco.graph.storage.export import episode_table, export_episodes
from deepkoco.graph.storage.read import RecordedRun, read_episodes
from deepkoco.graph.storage.write import write_episodes

__all__ = [
    "EpisodeFileError",
    "EpisodeWriter",
    "RecordedNode",
    "RecordedRun",
    "describe_graph",
    "episode_table",
    "export_episodes",
    "graph_from_description",
    "read_episodes",
    "write_episodes",
]
