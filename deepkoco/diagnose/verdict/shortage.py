"""What a log lacks for a diagnosis: length, motion, a channel, or commands that change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.experiment_design.experiment_setup import SHORTEST, feasible_seconds, make_stage
from deepkoco.diagnose.experiment_design.families import FAMILIES
from deepkoco.diagnose.experiment_design.rehearsal import rehearse
from deepkoco.diagnose.experiment_design.search import sequences
from deepkoco.fit.data.noise import Noise
from deepkoco.fit.data.windows import STANDSTILL
from deepkoco.logs.recording import Recording
from deepkoco.systems import System

SHARES = (0.1, 0.2, 0.5, 1.0)  # of the actuator's range, at which the motion is tried out
STILL = 1e-3  # share of the actuator's range within which a command does not change


def missing_for_diagnosis(
    recordings: Sequence[Recording],
    system: System,
    noise: Sequence[Noise],
    length: float,
    found: int,
    needed: int,
) -> tuple[str, ...]:
    """Sentences about what is missing, the first of them with the count.

    Args:
        recordings: The logs.
        system: The system.
        noise: Of each measurement.
        length: Of a window [s].
        found: Windows in which the joint moves.
        needed: Windows that a diagnosis takes at least.
    """
    texts = [
        f"Only {found} windows of {length:.2g} s in which the joint moves; at least {needed} are needed.",
        *_short(recordings, length, needed),
        *_absent(recordings, system),
        *_unmoved(recordings, system, noise),
    ]
    return (" ".join([*texts, _remedy(system, length, needed)]),)


def _short(recordings: Sequence[Recording], length: float, needed: int) -> list[str]:
    total = sum(max(r.stop - r.start, 0.0) for r in recordings)
    if total >= (needed + 1) * length:
        return []
    return [
        f"The logs are {total:.2g} s long together; {_good_length(length, needed):.0f} s are a good length."
    ]


def _good_length(length: float, needed: int) -> float:
    return max(2.0 * needed, SHORTEST) * length


def _absent(recordings: Sequence[Recording], system: System) -> list[str]:
    texts = []
    for channel in system.measurements:
        if not any(channel.name in r.channels for r in recordings):
            texts.append(
                f"The measurement {channel.name} ({channel.unit}) is missing; map it, if it was recorded."
            )
    return texts


def _unmoved(recordings: Sequence[Recording], system: System, noise: Sequence[Noise]) -> list[str]:
    texts = []
    for command in system.commands[: len(system.command_joints)]:  # the others switch or set modes
        values = [r.channels[command.name].value for r in recordings if command.name in r.channels]
        spans = [float(np.ptp(v)) for v in values if len(v)]
        if spans and max(spans) < STILL * (command.high - command.low):
            texts.append(
                f"The command {command.name} stays at {float(values[0][0]):.3g} {command.unit} all the time."
            )
    for channel, own in zip(system.measurements, noise, strict=True):
        spans = [
            float(np.ptp(r.channels[channel.name].value)) for r in recordings if channel.name in r.channels
        ]
        if spans and max(spans) < STANDSTILL * own.sd:
            texts.append(
                f"{channel.name} changes by {max(spans):.2g} {channel.unit} only, less than {STANDSTILL:.0f} times its "
                f"noise of {own.sd:.2g} {channel.unit}."
            )
    return texts


def _remedy(system: System, length: float, needed: int) -> str:
    """Steps that would move the unit well beyond its noise, by simulation of the nominal system."""
    seconds = feasible_seconds(system, _good_length(length, needed))
    stage = make_stage(system, seconds)
    points = np.full((1, FAMILIES["steps"].dimension(stage.frame)), 0.0)
    points[:] = np.random.default_rng(0).random(points.shape)
    points[:, -1] = 0.0
    full = sequences(stage, FAMILIES["steps"], points)
    channel = system.commands[0]
    for share in SHARES:
        played = rehearse(stage, stage.rest + share * (full - stage.rest), [stage.start.values])
        if len(played.windows) >= needed + 2:
            middle = round(float(stage.rest[0]), 6) + 0.0  # what is left of solving for it is no command
            size = share * min(channel.high - middle, middle - channel.low)
            return (
                f"Record {seconds:.0f} s of steps of several levels up to {size:.2g} {channel.unit} about "
                f"{middle:.2g} {channel.unit}, such as: deepkoco record --excitation steps "
                f"--seconds {seconds:.0f} --amplitude {size:.2g}"
            )
    return f"Record at least {seconds:.0f} s of motion with steps, prbs or a chirp over the whole range of commands."
