"""What logs lack for a diagnosis: length, motion, a channel, or changing commands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.experiment_design.experiment_setup import (
    SHORTEST,
    DesignError,
    feasible_seconds,
    make_stage,
)
from deepkoco.diagnose.experiment_design.families import FAMILIES
from deepkoco.diagnose.experiment_design.rehearsal import rehearse
from deepkoco.diagnose.experiment_design.search import sequences
from deepkoco.fit.data.noise import Noise
from deepkoco.fit.data.windows import STANDSTILL
from deepkoco.logs.recording import Recording
from deepkoco.systems import System

SHARES = (0.1, 0.2, 0.5, 1.0)  # amplitudes that are simulated, as shares of the actuator's range
CONSTANT_WITHIN = 1e-3  # share of the actuator's range within which a command counts as constant


def missing_for_diagnosis(
    recordings: Sequence[Recording],
    system: System,
    noise: Sequence[Noise],
    length: float,
    found: int,
    needed: int,
) -> tuple[str, ...]:
    """Return one text that says what is missing and what to record.

    Args:
        recordings: The logs.
        system: The system.
        noise: Of each measurement.
        length: Length of a window [s].
        found: Windows in which the joint moves.
        needed: Least number of windows for a diagnosis.
    """
    texts = [
        f"The joint moves in only {found} windows of {length:.2g} s; at least {needed} are needed.",
        *_short(recordings, length, needed),
        *_absent(recordings, system),
        *_unmoved(recordings, system, noise),
    ]
    return (" ".join([*texts, _remedy(system, length, needed)]),)


def _short(recordings: Sequence[Recording], length: float, needed: int) -> list[str]:
    total = sum(max(r.stop - r.start, 0.0) for r in recordings)
    if total >= (needed + 1) * length:
        return []
    return [f"The logs last {total:.2g} s in total; about {_good_length(length, needed):.0f} s suffice."]


def _good_length(length: float, needed: int) -> float:
    return max(2.0 * needed, SHORTEST) * length


def _absent(recordings: Sequence[Recording], system: System) -> list[str]:
    texts = []
    for channel in system.measurements:
        if not any(channel.name in r.channels for r in recordings):
            texts.append(
                f"The measurement {channel.name} ({channel.unit}) is missing. If it was recorded, map its column in "
                "the sidecar."
            )
    return texts


def _unmoved(recordings: Sequence[Recording], system: System, noise: Sequence[Noise]) -> list[str]:
    texts = []
    for command in system.commands[: len(system.command_joints)]:  # the others switch or set modes
        values = [r.channels[command.name].value for r in recordings if command.name in r.channels]
        spans = [float(np.ptp(v)) for v in values if len(v)]
        if spans and max(spans) < CONSTANT_WITHIN * (command.high - command.low):
            texts.append(
                f"The command {command.name} is constant at {float(values[0][0]):.3g} {command.unit}."
            )
    for channel, own in zip(system.measurements, noise, strict=True):
        spans = [
            float(np.ptp(r.channels[channel.name].value)) for r in recordings if channel.name in r.channels
        ]
        if spans and max(spans) < STANDSTILL * own.sd:
            texts.append(
                f"The measurement {channel.name} changes by only {max(spans):.2g} {channel.unit}, less than "
                f"{STANDSTILL:.0f} times its noise of {own.sd:.2g} {channel.unit}."
            )
    return texts


def _remedy(system: System, length: float, needed: int) -> str:
    """Return the smallest tried steps that move the simulated nominal system in enough windows."""
    seconds = feasible_seconds(system, _good_length(length, needed))
    anything = f"Record at least {seconds:.0f} s of steps, prbs or a chirp over the whole range of commands."
    try:
        stage = make_stage(system, seconds)
    except DesignError as error:
        return f"{anything} Smaller commands cannot be simulated: {error}."
    points = np.full((1, FAMILIES["steps"].dimension(stage.frame)), 0.0)
    points[:] = np.random.default_rng(0).random(points.shape)
    points[:, -1] = 0.0
    full = sequences(stage, FAMILIES["steps"], points)
    channel = system.commands[0]
    for share in SHARES:
        played = rehearse(stage, stage.rest + share * (full - stage.rest), [stage.start.values])
        if len(played.windows) >= needed + 2:
            middle = round(float(stage.rest[0]), 6) + 0.0  # removes the solver's rounding error
            size = share * min(channel.high - middle, middle - channel.low)
            return (
                f"Record {seconds:.0f} s of steps of several levels, up to {size:.2g} {channel.unit} on either side of "
                f"{middle:.2g} {channel.unit}, for example: deepkoco record --excitation steps "
                f"--seconds {seconds:.0f} --amplitude {size:.2g}"
            )
    return anything
