"""The replay on disk, one file for what was added between two checkpoints: nothing is written twice."""

from __future__ import annotations

from pathlib import Path

from torch import Tensor

from baselines.replay import Replay
from deepkoco.agent.checkpoint import damaged, load_checkpoint, save_checkpoint
from deepkoco.agent.replay_files import REPLAY_FOLDER


def write_replay(folder: Path, part: int, tensors: dict[str, Tensor]) -> None:
    """Write what was added since the part before, all or nothing.

    Args:
        folder: The run's folder.
        part: Number of the file. One that a killed run left behind its last checkpoint is replaced: the episodes are
            collected again, with the same outcome.
        tensors: As given by `Replay.since`.
    """
    path = _path(folder, part)
    path.parent.mkdir(exist_ok=True)
    save_checkpoint(path, tensors)


def read_replay(folder: Path, parts: int, replay: Replay) -> None:
    """Fill a replay.

    Args:
        folder: The run's folder.
        parts: How many files belong to the checkpoint.
        replay: An empty replay.

    Raises:
        CheckpointError: A file is missing or damaged, or another version wrote it.
    """
    for part in range(parts):
        path = _path(folder, part)
        state = load_checkpoint(path)
        try:
            replay.extend(state)
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise damaged(path, error) from error


def _path(folder: Path, part: int) -> Path:
    return folder / REPLAY_FOLDER / f"{part:04d}.pt"
