"""Systems that move by themselves: the physics of the copies in states and in frames."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

from deepkoco.envs.distractors.copied import find_copied
from deepkoco.envs.distractors.drives import ACTION, DRIVES, check_drive
from deepkoco.envs.distractors.options import DistractorError, Setup
from deepkoco.systems import System, make_system, rk4_step

LONGEST_STEP = 0.025  # of the integration [s]


class WanderingSystems:
    """K systems per environment that do not act on the task.

    They feel the agent's action with the drive "action" alone.

    Args:
        setup: Its ``system`` names the task, or the system of the task, that start states and observations are of.

    Raises:
        DistractorError: There is no such task, system or drive.

    Source: thesis ch. 5 (distractor pendulums).
    """

    def __init__(self, setup: Setup) -> None:
        check_drive(setup.options.drive)
        if not isinstance(setup.system, str):
            raise DistractorError(
                "copies of this environment are entries of states; frames can hold copies of a task of this package: "
                "give task.system=NAME"
            )
        self.task = find_copied(setup.system)
        self.scene: System = self.task.scene(make_system(self.task.system))
        self.batch, self.copies = setup.batch, setup.options.copies
        self._setup, self._drive_by = setup, DRIVES.get(setup.options.drive)
        self._limits = torch.tensor(self.task.command_limits, dtype=torch.float64)
        if self._drive_by is None and self._limits.numel() != setup.actions:
            raise DistractorError(
                f'distractor_options.drive = "{ACTION}": the agent has {setup.actions} actions, and '
                f'"{setup.system}" takes {self._limits.numel()}; give the system of the task, or another drive'
            )
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

    def advance(self, drives: np.ndarray | None = None) -> None:
        """Go on by one control period.

        Args:
            drives: The agent's action (B, M) in shares of its limits; copies with a drive of their own do without.
        """
        if self._drive_by is not None:
            self._drive = self._drive_by(self._drive, self._generator)
        else:
            assert drives is not None
            acted = torch.as_tensor(drives, dtype=torch.float64)
            self._drive = acted[:, None].expand_as(self._drive)
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
