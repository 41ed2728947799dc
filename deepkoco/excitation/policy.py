"""Excitation in closed loop by a trained policy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from deepkoco.excitation.signal import Excitation, ExcitationError
from deepkoco.systems import one_joint


def policy_excitation(policy: Callable[[Sequence[float]], float], limits: tuple[float, float]) -> Excitation:
    """Make an excitation from a policy, in closed loop.

    Args:
        policy: Measurement -> command.
        limits: Limits (low, high) of the command, in its unit.
    """

    def command(t: float, measurement: Sequence[float]) -> float:
        return min(max(float(policy(measurement)), limits[0]), limits[1])

    return command


def load_policy_excitation(folder: str | Path, system: str) -> tuple[Excitation, float]:
    """Load a trained policy as an excitation in closed loop; it gets the observations of the system's task.

    Args:
        folder: Folder of the trained policy.
        system: Name of the system.

    Returns:
        The excitation, and the control rate of the training [Hz].

    Raises:
        ExcitationError: The folder contains no policy, or one for other observations or commands.
    """
    # Imported here because agent and envs are slow to import and other excitations do not need them.
    import torch

    from deepkoco.agent.policy import KoopmanPolicy, load_model
    from deepkoco.envs.tasks import SWING_UPS

    physics, task = one_joint(system), SWING_UPS[system]
    try:
        model, planner, low, high = load_model(folder)
    except (OSError, ValueError) as error:
        raise ExcitationError(f"{folder}: contains no policy: {error}") from error
    width = len(task.observation_bounds)
    if model.observation_size != width:
        raise ExcitationError(
            f"{folder}: the policy takes {model.observation_size} observations, {system} gives "
            f"{width}; give a policy that was trained without distractors and without past actions"
        )

    limit = min(task.command_limit, physics.command.high)
    if not (np.array_equal(low, [-limit]) and np.array_equal(high, [limit])):
        raise ExcitationError(
            f"{folder}: the policy's actions lie in {low.tolist()} to {high.tolist()}, the commands of {system} "
            f"in [{-limit:g}] to [{limit:g}] {physics.command.unit}; give a policy that was trained on {system} "
            'with action_units="physical"'
        )
    policy = KoopmanPolicy(model, planner, low, high)

    def act(measurement: Sequence[float]) -> float:
        seen = task.observation(physics, torch.tensor(measurement, dtype=torch.float64))
        return float(policy.act(seen.numpy())[0])

    return policy_excitation(act, (-limit, limit)), 1.0 / model.time_step
