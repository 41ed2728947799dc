"""Systems that move by themselves: the physics of the copies in states and in frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from deepkoco.envs.distractors.options import DistractorError, Setup
from deepkoco.envs.tasks import TASKS, FixedTask
from deepkoco.systems import System, make_system, rk4_step

OU_MEMORY = 0.85  # per control step
OU_SPREAD = 0.85  # stationary standard deviation, per command limit
LONGEST_STEP = 0.025  # of the integration [s]

Drive = Callable[[Tensor, torch.Generator], Tensor]
"""From the drives (B, K, M) of the step before, in command limits, to those of this step."""


def ornstein_uhlenbeck(drive: Tensor, generator: torch.Generator) -> Tensor:
    """A drive that wanders (Ornstein-Uhlenbeck); the thesis does not say how its distractors are driven."""
    noise = torch.randn(drive.shape, generator=generator, dtype=torch.float64)
    return OU_MEMORY * drive + OU_SPREAD * (1.0 - OU_MEMORY**2) ** 0.5 * noise


def uniform(drive: Tensor, generator: torch.Generator) -> Tensor:
    """A random policy: every command anew, uniform within the limits."""
    return 2.0 * torch.rand(drive.shape, generator=generator, dtype=torch.float64) - 1.0


DRIVES: dict[str, Drive] = {"ou": ornstein_uhlenbeck, "random": uniform}


def find_copied(name: str) -> FixedTask:
    """The task of a name, or the first one of the system of that name.

    Raises:
        DistractorError: There is none.
    """
    known = {key: task for key, task in TASKS.items() if isinstance(task, FixedTask)}
    found = [task for key, task in known.items() if name in (key, task.system)]
    if not found:
        raise DistractorError(f'copies of "{name}": no such task or system; use one of {", ".join(known)}')
    return known.get(name, found[0])


class WanderingSystems:
    """K systems per environment that neither act on the task nor feel the action.

    Args:
        setup: Its ``system`` names the task, or the system of the task, that start states and observations are of.

    Raises:
        DistractorError: There is no such task, system or drive.

    Source: thesis ch. 5 (distractor pendulums).
    """

    def __init__(self, setup: Setup) -> None:
        if setup.options.drive not in DRIVES:
            raise DistractorError(
                f'distractor_options.drive = "{setup.options.drive}"; choose one of {", ".join(DRIVES)}'
            )
        self.task = find_copied(setup.system)
        self.scene: System = self.task.scene(make_system(self.task.system))
        self.batch, self.copies = setup.batch, setup.options.copies
        self._setup, self._drive_by = setup, DRIVES[setup.options.drive]
        self._limits = torch.tensor(self.task.command_limits, dtype=torch.float64)
        self._parameters = self.scene.default_parameters()
        period = 1.0 / self.task.control_rate
        self._substeps = math.ceil(period / LONGEST_STEP - 1e-9)
        self._dt = period / self._substeps
        self._generator = torch.Generator()
        width = len(self.scene.state_names)
        self._state = torch.zeros(self.batch, self.copies, width, dtype=torch.float64)
        self._drive = torch.zeros(self.batch, self.copies, self._limits.numel(), dtype=torch.float64)

    def seed(self, seed: int | Sequence[int]) -> None:
        """Start the generator anew."""
        self._generator.manual_seed(int(self._setup.generator(seed).integers(2**62)))

    def restart(self, where: np.ndarray | None = None) -> None:
        """Draw new start states in the environments ``where`` (B,) bool, by default in all."""
        start = self.task.start(self.scene, self.batch * self.copies, self._generator)
        start = start.view(self.batch, self.copies, -1)
        mask = torch.ones(self.batch, dtype=torch.bool) if where is None else torch.as_tensor(where)
        mask = mask.view(-1, 1, 1)
        self._state = torch.where(mask, start, self._state)
        self._drive = torch.where(mask, 0.0, self._drive)

    def advance(self) -> None:
        """Go on by one control period."""
        self._drive = self._drive_by(self._drive, self._generator)
        command = self.scene.effort_of(self._limits * self._drive.clamp(-1.0, 1.0))
        effort = self.scene.actuate(command, self._parameters)
        for _ in range(self._substeps):
            after = rk4_step(self.scene, self._state, effort, self._dt, self._parameters)
            joints, limit = self.scene.joints, self.task.speed_limit
            after[..., joints : 2 * joints].clamp_(-limit, limit)  # as the task's own world does
            self._state = after

    def observations(self) -> np.ndarray:
        """What an agent on the copies would see, (B, K, N) float64."""
        measured = self.scene.measure(self._state, self._parameters)
        return self.task.observation(self.scene, measured).numpy()

    def draw(self, observation: np.ndarray, image: np.ndarray) -> None:
        """Draw one copy, seen as ``observation`` (N,), onto a picture uint8 (size, size, 3)."""
        self.task.draw_observation(self.scene, observation, image)
