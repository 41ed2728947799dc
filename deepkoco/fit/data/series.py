"""Commands and measurements of a recording as series of one system."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepkoco.fit.data.differenced import differenced_speeds, shown_between
from deepkoco.fit.data.even_stamps import with_even_stamps
from deepkoco.fit.data.goals_of_turns import in_turns_of
from deepkoco.logs.recording import LogError, Recording
from deepkoco.systems import System


@dataclass(frozen=True)
class CommandSeries:
    """Zero-order-hold commands of one log.

    Attributes:
        t: (n,) stamps [s].
        value: (n,), or (n, M) for M commands, in the commands' units.
        guessed: (n,) True where a command was put in for a row that the log lost; None where none was.
    """

    t: np.ndarray
    value: np.ndarray
    guessed: np.ndarray | None = None

    @property
    def changes(self) -> bool:
        """Whether a command changes in this log; in that of a free motion none does."""
        return bool((self.value != self.value[:1]).any())

    def column(self, index: int) -> np.ndarray:
        """(n,) values of one command."""
        return self.value if self.value.ndim == 1 else self.value[:, index]


def _goals(
    recording: Recording,
    system: System,
    series: dict[str, tuple[np.ndarray, np.ndarray]],
    name: str,
    t: np.ndarray,
) -> np.ndarray:
    """Values (n,) of a command; goals of a joint that turns in the turns in which its position counts."""
    value = recording.channels[name].value
    command = next(k for k, c in enumerate(system.commands) if c.name == name)
    if (
        system.commands[command].unit != "rad"
        or command >= len(system.command_joints)
        or not system.shows_states
    ):
        return value
    joint = system.command_joints[command]
    shown = zip(system.measurements, system.measured_states, strict=True)
    position = next((c for c, k in shown if k == joint and c.angle and c.name in series), None)
    if position is None or system.state_units[joint] != "rad":
        return value
    return in_turns_of(t, value, *series[position.name], recording.channels[position.name].value)


def channel_series(
    recording: Recording, system: System
) -> tuple[CommandSeries, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Commands and measurements of a recording, at the times that they show.

    Angles are unwrapped, stamps of a regular loop even, and speeds that are differences of positions stand between
    these. Commands stand where they act.

    Raises:
        LogError: A command or every measurement is missing, or a sample is not finite.
    """
    where = recording.path or "the recording"
    for command in system.commands:
        if command.name not in recording.channels and command.default is None:
            raise LogError(
                f'{where}: the command "{command.name}" of {system.name} is missing; map it in the sidecar'
                f"{system.way_to_hold(recording.channels)}"
            )
    for channel in (*system.commands, *system.measurements):
        logged = recording.channels.get(channel.name)
        if logged is not None and (
            wrong := int((~(np.isfinite(logged.value) & np.isfinite(logged.t))).sum())
        ):
            raise LogError(
                f'{where}: the channel "{channel.name}" has {wrong} of {len(logged.t)} samples that are not finite; '
                "leave these samples out"
            )
    series = {}
    for channel in system.measurements:
        if channel.name in recording.channels:
            measured = recording.channels[channel.name]
            # A range of more than one turn shows that the angle is not wrapped. It may also be in a wrong unit.
            wrapped = channel.angle and np.ptp(measured.value) <= 2.02 * math.pi
            value = np.unwrap(measured.value) if wrapped else measured.value
            series[channel.name] = (measured.t, value)
    if not series:
        wanted = ", ".join(c.name for c in system.measurements)
        raise LogError(f"{where}: no measurement of {system.name} is mapped; map at least one of: {wanted}")
    names = [command.name for command in system.commands if command.name in recording.channels]
    differenced = differenced_speeds(series, system)
    series, moved = with_even_stamps(series, [recording.channels[name].t for name in names])
    series = shown_between(series, differenced)
    logged = [
        replace(recording.channels[name], t=t, value=_goals(recording, system, series, name, t))
        for name, t in zip(names, moved, strict=True)
    ]
    if not logged:
        # A log of a free motion: every command is at its default.
        ends = [(t[0], t[-1]) for t, _ in series.values()]
        defaults = np.array([command.default for command in system.commands], dtype=float)
        t = np.array([min(first for first, _ in ends), max(last for _, last in ends)])
        value = np.tile(defaults, (2, 1))
        return CommandSeries(t, value[:, 0] if value.shape[1] == 1 else value), series
    guesses = [command.t[command.guessed] for command in logged if command.guessed is not None]
    if len(system.commands) == 1:
        return CommandSeries(logged[0].t - recording.early, logged[0].value, logged[0].guessed), series
    # Each command holds until its next stamp: on the union of all stamps they are one series.
    t = np.unique(np.concatenate([command.t for command in logged]))
    t = t[t >= max(command.t[0] for command in logged)]
    held = {name: command.hold(t) for name, command in zip(names, logged, strict=True)}
    columns = [held.get(command.name, np.full(len(t), command.default)) for command in system.commands]
    guessed = np.isin(t, np.concatenate(guesses)) if guesses else None
    return CommandSeries(t - recording.early, np.column_stack(columns), guessed), series


def scatter_taken_out(
    recordings: Sequence[Recording],
    series: Sequence[Mapping[str, tuple[np.ndarray, np.ndarray]]],
    names: Sequence[str],
) -> tuple[float, ...]:
    """Standard deviation of logged stamps about the times that `channel_series` gives in their place [s].

    Args:
        recordings: The logs.
        series: Measurements of each, as `channel_series` gives them.
        names: Channels.

    Returns:
        One for each channel; 0 where no log has it, or all its stamps are as logged. Empty if all are 0.
    """
    found = []
    for name in names:
        moves = [
            recording.channels[name].t - own[name][0]
            for recording, own in zip(recordings, series, strict=True)
            # Differenced speeds have moved by half a sample, and are one sample shorter.
            if name in own and len(own[name][0]) == len(recording.channels[name].t)
        ]
        moves = [late - late.mean() for late in moves if late.any()]
        found.append(float(np.concatenate(moves).std()) if moves else 0.0)
    return tuple(found) if any(found) else ()
