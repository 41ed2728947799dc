"""How much is learned in an iteration, and with which step size."""

from __future__ import annotations

from deepkoco.agent.config import TrainingConfig


def planned_updates(config: TrainingConfig, iteration: int, windows: int) -> int:
    """Updates of an iteration.

    Args:
        config: Hyper-parameters.
        iteration: Its number, from 0.
        windows: Training windows in the buffer.

    Returns:
        All epochs of the first iteration; those of a later one up to their cap.
    """
    epoch = max(1, windows // (config.chunks * (config.chunk_length - config.horizon)))
    if iteration == 0:
        return config.first_epochs * epoch
    return min(config.iteration_epochs * epoch, config.iteration_updates)


def step_size(config: TrainingConfig, episodes: int) -> float:
    """Factor on the learning rates: 1 in the first iteration, `final_learning_rate` in the last.

    Args:
        config: Hyper-parameters.
        episodes: Collected so far.
    """
    later = max(1, config.total_episodes - config.first_episodes)
    done = max(0, episodes - config.first_episodes) / later
    return 1.0 - done * (1.0 - config.final_learning_rate)
