"""Play commands from a file to a unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.excitation.signal import Excitation
from deepkoco.systems import JointSystem

TIME = "t"  # column of the stamps [s]


class CommandFileError(ValueError):
    """A file of commands cannot be read, or does not suit the unit."""


@dataclass(frozen=True)
class PlayedCommands:
    """A sequence of commands. Each one holds until the next.

    Attributes:
        t: (n,) stamps [s], increasing.
        value: (n,) commands, in the command's unit.
    """

    t: np.ndarray
    value: np.ndarray

    @property
    def rate(self) -> float:
        """Commands per second [Hz]."""
        return (len(self.t) - 1) / float(self.t[-1] - self.t[0])

    def rate_on(self, sensor_rate: float) -> float:
        """Rate of commands at which a unit plays the whole sequence [Hz].

        Args:
            sensor_rate: Sensor rate of the unit [Hz], which takes at most one command per sample.

        Raises:
            CommandFileError: The sequence is faster than the sensor.
        """
        if self.rate > sensor_rate * (1.0 + 1e-6):
            raise CommandFileError(
                f"the file has {self.rate:.4g} commands per second, the unit's sensor {sensor_rate:.4g} samples: give "
                f"at most one command per sample, or --rate {sensor_rate:.4g} to leave commands out"
            )
        return min(self.rate, sensor_rate)

    @property
    def seconds(self) -> float:
        """Length of the sequence, with one mean period for the last command [s]."""
        return float(self.t[-1] - self.t[0]) + 1.0 / self.rate

    def excitation(self) -> Excitation:
        """Convert the sequence to an excitation; after its end the last command holds."""
        # A tick can be early by jitter. Up to a quarter of a period early, it still gets its own command.
        stamps = self.t - self.t[0] - 0.25 / self.rate

        def command(t: float, measurement: Sequence[float]) -> float:
            return float(self.value[max(int(np.searchsorted(stamps, t, side="right")) - 1, 0)])

        return command


def load_commands(path: str | Path, system: JointSystem) -> PlayedCommands:
    """Read a CSV of commands: a column ``t`` [s] and one with the name of the command, in its unit.

    Raises:
        CommandFileError: The file cannot be read, lacks a column or contains a cell that is not a finite number. Stamps
            do not increase, or a command exceeds the limits of the system.
    """
    path, channel = Path(path), system.commands[0]
    try:
        table = pd.read_csv(path)
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise CommandFileError(f"{path}: cannot be read as CSV: {error}") from error
    missing = [name for name in (TIME, channel.name) if name not in table]
    if missing:
        raise CommandFileError(
            f'{path}: has no column "{missing[0]}"; commands of {system.name} need the columns {TIME} (s) and '
            f"{channel.name} ({channel.unit})"
        )
    try:
        t, value = (table[name].to_numpy(dtype=np.float64) for name in (TIME, channel.name))
    except ValueError as error:
        raise CommandFileError(f"{path}: {error}") from error
    if len(t) < 2 or not math.isfinite(float(np.sum(t) + np.sum(value))):
        raise CommandFileError(f"{path}: needs at least two rows of finite numbers")
    late = np.flatnonzero(np.diff(t) <= 0.0)
    if len(late):
        raise CommandFileError(
            f"{path}: the time in row {late[0] + 3} is not later than in the row before; sort the rows"
        )
    outside = np.flatnonzero((value < channel.low - 1e-9) | (value > channel.high + 1e-9))
    if len(outside):
        raise CommandFileError(
            f"{path}: the {channel.name} in row {outside[0] + 2} is {value[outside[0]]:g} {channel.unit}, outside "
            f"{channel.low:g} to {channel.high:g} {channel.unit} of {system.name}"
        )
    return PlayedCommands(t, value)
