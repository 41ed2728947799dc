"""What drives the copies of a system: noise, random commands, or the action of the agent."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from deepkoco.envs.distractors.options import DistractorError

OU_MEMORY = 0.85  # per control step
OU_SPREAD = 0.85  # stationary standard deviation, per command limit

Drive = Callable[[Tensor, torch.Generator], Tensor]
"""From the drives (..., M) of the step before, in command limits, to those of this step."""


def ornstein_uhlenbeck(drive: Tensor, generator: torch.Generator) -> Tensor:
    """A drive that wanders (Ornstein-Uhlenbeck); the thesis does not say how its distractors are driven."""
    noise = torch.randn(drive.shape, generator=generator, dtype=torch.float64)
    return OU_MEMORY * drive + OU_SPREAD * (1.0 - OU_MEMORY**2) ** 0.5 * noise


def uniform(drive: Tensor, generator: torch.Generator) -> Tensor:
    """A random policy: every command anew, uniform within the limits."""
    return 2.0 * torch.rand(drive.shape, generator=generator, dtype=torch.float64) - 1.0


DRIVES: dict[str, Drive] = {"ou": ornstein_uhlenbeck, "random": uniform}
ACTION = "action"
"""The drive of copies that get the command which the agent gives to the task: correlated with the action."""


def check_drive(name: str) -> None:
    """Check the name of a drive.

    Raises:
        DistractorError: There is none of that name.
    """
    if name not in DRIVES and name != ACTION:
        known = ", ".join([*DRIVES, ACTION])
        raise DistractorError(f'distractor_options.drive = "{name}"; choose one of {known}')
