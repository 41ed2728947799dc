"""Recordings on disk: episodes of every runtime in MCAP files, streamed, read back exactly, exported."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from deepkoco.graph.episodes.storage.container import EpisodeFileError
from deepkoco.graph.episodes.storage.description import RecordedNode, describe_graph, graph_from_description
from deepkoco.graph.episodes.storage.episode_writer import EpisodeWriter
from deepkoco.graph.episodes.storage.read import RecordedRun, read_episodes
from deepkoco.graph.episodes.storage.write import write_episodes

if TYPE_CHECKING:
    from deepkoco.graph.episodes.export import episode_table, export_episodes

# Imported when they are asked for: tables need pandas, which the runtimes that write recordings do without.
_LATER = ("episode_table", "export_episodes")


def __getattr__(name: str) -> Any:
    if name not in ("export", *_LATER):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    export = import_module(f"{__name__}.export")
    return export if name == "export" else getattr(export, name)


def __dir__() -> list[str]:
    return sorted({*globals(), "export", *_LATER})


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
