"""Joint by joint: the error of a robot's simulation before and after, and what was found there."""

from __future__ import annotations

from typing import NamedTuple

from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.gain import Gain
from deepkoco.diagnose.report.figures.layout import held_out_models
from deepkoco.diagnose.report.text import spoken
from deepkoco.pages.units import in_one_unit, readable
from deepkoco.systems import System

NEAR_NOISE, FAR = 2.0, 10.0  # errors, in standard deviations of the sensor's noise, between the three levels
LEVELS = {"good": "close to the noise", "fair": "some times the noise", "poor": "far above the noise"}


class JointError(NamedTuple):
    """Held-out error of one joint.

    Attributes:
        joint: Name.
        channel: Channel that measures it.
        unit: Unit of the errors.
        given: Root mean square error of the simulation as given.
        final: Same, of the best simulation of the report.
        noise: Standard deviation of the sensor's noise.
    """

    joint: str
    channel: str
    unit: str
    given: float
    final: float
    noise: float


class JointRow(NamedTuple):
    """One row of the page's table."""

    joint: str
    given: str
    final: str
    noise: str
    found: str
    level: str


def joint_errors(diagnosis: Diagnosis, details: Details) -> list[JointError]:
    """Return the error of every joint that a channel measures, in the order of the joints; none without a gain."""
    gain = diagnosis.gain
    if gain is None:
        return []
    system, result = details.system, []
    last = "extended" if "extended" in held_out_models(diagnosis) and not gain.as_given else "refit"
    errors, noise = {c.name: c for c in gain.channels}, noise_by_channel(gain, system)
    for j, name in enumerate(system.joint_names):
        # The position where there is one: a speed follows from it.
        order = [
            c for s in (j, j + system.joints) for c, state in enumerate(system.measured_states) if state == s
        ]
        shown = [n for c in order if (n := system.measurements[c].name) in errors]
        if shown:
            error = errors[shown[0]]
            result.append(
                JointError(
                    name, error.name, error.unit, error.baseline, getattr(error, last), noise[error.name]
                )
            )
    return result


def noise_by_channel(gain: Gain, system: System) -> dict[str, float]:
    """Return the standard deviation of the noise of each channel of a system, in its unit."""
    return {c.name: n.sd for c, n in zip(system.measurements, gain.replayed.noise, strict=True)}


def level(error: float, noise: float) -> str:
    """Return the level of an error: good, fair or poor."""
    if error <= NEAR_NOISE * noise:
        return "good"
    return "fair" if error <= FAR * noise else "poor"


def joint_rows(diagnosis: Diagnosis) -> list[JointRow]:
    """Return a row for each joint of a robot with several joints; none for other systems."""
    details = diagnosis.details
    if details is None or details.system.own_joints < 2:
        return []
    rows = []
    for e in joint_errors(diagnosis, details):
        (given, final, noise), unit = in_one_unit([e.given, e.final, e.noise], e.unit)
        found = "; ".join(_found(diagnosis, details.system, e.joint))
        rows.append(
            JointRow(
                e.joint,
                f"{given} {unit}",
                f"{final} {unit}",
                f"{noise} {unit}",
                found,
                level(e.final, e.noise),
            )
        )
    return rows


def _found(diagnosis: Diagnosis, system: System, joint: str) -> list[str]:
    """Causes at a joint, each with its values."""
    texts = []
    for cause in diagnosis.causes:
        if joint in places_of(cause.name, system):
            values = [
                f"{spoken(n.rpartition('.')[2])} {readable(e.value, e.unit)}"
                for n, e in cause.parameters.items()
            ]
            texts.append(f"{spoken(cause.name.partition('(')[0])}: {', '.join(values)}")
    return texts


def places_of(cause: str, system: System) -> tuple[str, ...]:
    """Return the joints at which a cause acts, by its name; none for a cause of the whole system."""
    inner = cause.partition("(")[2].removesuffix(")")
    if inner in system.joint_names:
        return (inner,)
    commands = {
        c.name: system.joint_names[j] for c, j in zip(system.commands, system.command_joints, strict=False)
    }
    if inner in commands:
        return (commands[inner],)
    channels = [c.name for c in system.measurements]
    if inner in channels:
        return (system.joint_names[system.measured_states[channels.index(inner)] % system.joints],)
    return ()
