"""Recordings on disk: episodes of every runtime in MCAP files, streamed, read back exactly, exported."""

from typing import TYPE_CHECKING, Any

from deepkoco.graph.storage.container import EpisodeFileError
from deepkoco.graph.storage.description import RecordedNode, describe_graph, graph_from_description
from deepkoco.graph.storage.episode_writer import EpisodeWriter
from deepkoco.graph.storage.read import RecordedRun, read_episodes
from deepkoco.graph.storage.write import write_episodes

if TYPE_CHECKING:
    from deepkoco.graph.storage.export import episode_table, export_episodes


def __getattr__(name: str) -> Any:
    # Tables need pandas, which the runtimes that write recordings do without.
    if name not in ("episode_table", "export_episodes"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from deepkoco.graph.storage import export

    return getattr(export, name)


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
