"""Collected episodes on disk, one file per iteration: what was recorded once never changes again."""

from __future__ import annotations

from pathlib import Path

from deepkoco.agent.buffer import Episode
from deepkoco.agent.checkpoint import damaged, load_checkpoint, save_checkpoint

REPLAY_FOLDER = "replay"


def write_replay(folder: Path, iteration: int, episodes: list[Episode]) -> None:
    """Write the episodes of an iteration, all or nothing.

    A checkpoint that held the frames too would write a gigabyte again and again.

    Args:
        folder: The run's folder.
        iteration: Number of the iteration. A file that a killed run left behind its last checkpoint is replaced:
            the iteration is collected again, with the same outcome.
        episodes: What it collected.
    """
    path = _path(folder, iteration)
    path.parent.mkdir(exist_ok=True)
    save_checkpoint(
        path,
        {
            "observations": [episode.observations for episode in episodes],
            "actions": [episode.actions for episode in episodes],
            "costs": [episode.costs for episode in episodes],
            "finals": [episode.final for episode in episodes],
        },
    )


def read_replay(folder: Path, iterations: int) -> list[Episode]:
    """Read the episodes of the first iterations.

    Args:
        folder: The run's folder.
        iterations: How many.

    Returns:
        The episodes in the order they were collected.

    Raises:
        CheckpointError: A file is missing or damaged, or another version wrote it.
    """
    episodes = []
    for iteration in range(iterations):
        path = _path(folder, iteration)
        state = load_checkpoint(path)
        try:
            finals = state.get("finals", [None] * len(state["costs"]))  # earlier releases did not store them
            recorded = zip(state["observations"], state["actions"], state["costs"], finals, strict=True)
            episodes += [Episode(*tensors) for tensors in recorded]
        except (KeyError, TypeError, ValueError) as error:
            raise damaged(path, error) from error
    return episodes


def _path(folder: Path, iteration: int) -> Path:
    return folder / REPLAY_FOLDER / f"{iteration:03d}.pt"
