"""Catalogue of causes. A new cause is a constant in the file of its family and one line here."""

from __future__ import annotations

from deepkoco.diagnose.causes.actuator import (
    ASYMMETRY,
    BACKLASH,
    CROSSTALK,
    DEAD_ZONE,
    DRIVE_STRENGTH,
    GAIN,
    GAIN_CURVE,
    GAIN_DRIFT,
    RATE_LIMIT,
    SATURATION,
    TORQUE_BIAS,
    TORQUE_SPEED_CURVE,
    UNIT_SLIP,
)
from deepkoco.diagnose.causes.asymmetric_friction import ASYMMETRIC_VISCOUS
from deepkoco.diagnose.causes.body import BODY_MASS, FORCE, LENGTH, PAYLOAD, TILT
from deepkoco.diagnose.causes.cause import Cause, Hint, Motion, kind_of
from deepkoco.diagnose.causes.choose import UnknownCauseError, causes_named, measured_channels, shown_causes
from deepkoco.diagnose.causes.disturbance import COGGING, CONSTANT_LOAD, PERIODIC, SPRING
from deepkoco.diagnose.causes.drive import ELASTIC
from deepkoco.diagnose.causes.event import BODY_PUSH, EVENT
from deepkoco.diagnose.causes.friction import (
    BRISTLE,
    COULOMB,
    LOAD_FRICTION,
    LUGRE,
    QUADRATIC,
    STRIBECK,
    VISCOUS,
)
from deepkoco.diagnose.causes.parameter import CHANGED, SCALED, changed_causes, changed_parameter, is_changed
from deepkoco.diagnose.causes.sensor import (
    CHANNEL_SCALE,
    CHANNEL_SLIP,
    GEAR_PLAY,
    LOW_PASS,
    NOISE_LEVEL,
    QUANTISATION,
    SENSOR_BIAS,
    SENSOR_CROSSTALK,
    SENSOR_DRIFT,
    SENSOR_RIPPLE,
    SENSOR_SCALE,
    SENSOR_SHIFT,
    SPEED_BIAS,
)
from deepkoco.diagnose.causes.timing import (
    ACTUATION_DELAY,
    CHANNEL_DELAY,
    CLOCK_SKEW,
    JITTER,
    LAG,
    LOST_COMMANDS,
    SENSING_DELAY,
    SPEED_DELAY,
    STAMP_LEAD,
)
from deepkoco.own_objects import entry_point, entry_point_names
from deepkoco.systems import System
from deepkoco.systems.effects import EFFECTS, Effect, place

CAUSES: dict[str, Cause] = {
    cause.name: cause
    for cause in (
        ACTUATION_DELAY,
        SENSING_DELAY,
        CHANNEL_DELAY,
        SPEED_DELAY,
        LAG,
        CLOCK_SKEW,
        STAMP_LEAD,
        JITTER,
        LOST_COMMANDS,
        VISCOUS,
        COULOMB,
        STRIBECK,
        QUADRATIC,
        LOAD_FRICTION,
        ASYMMETRIC_VISCOUS,
        BRISTLE,
        LUGRE,
        GAIN,
        DRIVE_STRENGTH,
        TORQUE_BIAS,
        DEAD_ZONE,
        BACKLASH,
        SATURATION,
        GAIN_CURVE,
        GAIN_DRIFT,
        ASYMMETRY,
        CROSSTALK,
        TORQUE_SPEED_CURVE,
        RATE_LIMIT,
        CONSTANT_LOAD,
        SPRING,
        COGGING,
        PERIODIC,
        PAYLOAD,
        BODY_MASS,
        LENGTH,
        TILT,
        FORCE,
        SENSOR_BIAS,
        SPEED_BIAS,
        SENSOR_SCALE,
        CHANNEL_SCALE,
        SENSOR_DRIFT,
        SENSOR_SHIFT,
        SENSOR_RIPPLE,
        SENSOR_CROSSTALK,
        LOW_PASS,
        ELASTIC,
        GEAR_PLAY,
        NOISE_LEVEL,
        QUANTISATION,
        EVENT,
        BODY_PUSH,
        UNIT_SLIP,
        CHANNEL_SLIP,
        CHANGED,
        SCALED,
    )
}


ENTRY_POINTS = "deepkoco.causes"  # group in which an installed package declares causes
_INSTALLED: set[str] = set()


def register_cause(cause: Cause, effect: Effect | None = None) -> Cause:
    """Add a cause to the catalogue of every diagnosis of this process.

    Args:
        cause: The cause.
        effect: The effect of the same name that it frees, where the package has none.

    Returns:
        ``cause``.

    Raises:
        UnknownCauseError: There is another cause of that name, or no effect for it.
    """
    if CAUSES.get(cause.name, cause) is not cause:
        raise UnknownCauseError(f'there is a cause "{cause.name}" already; give another name')
    if effect is not None and effect.name != cause.name:
        raise UnknownCauseError(
            f'the cause is called "{cause.name}" and its effect "{effect.name}"; give both one name'
        )
    if effect is None and cause.name not in EFFECTS:
        raise UnknownCauseError(f'there is no effect "{cause.name}"; give it: register_cause(cause, effect)')
    if effect is not None:
        EFFECTS[effect.name] = effect
    CAUSES[cause.name] = cause
    return cause


def _register_installed() -> None:
    """Register what installed packages declare: a `Cause`, or a function that registers some."""
    for name in entry_point_names(ENTRY_POINTS):
        if name in _INSTALLED:
            continue
        _INSTALLED.add(name)
        declared = entry_point(ENTRY_POINTS, name)
        if isinstance(declared, Cause):
            register_cause(declared)
        else:
            declared()


def catalogue(system: System, regrouping: bool = False) -> dict[str, Cause]:
    """Return the causes at every joint, command, channel and parameter where they have a meaning, by their names.

    Args:
        system: A plain system.
        regrouping: Whether factors on parameters that a refit frees are among them, see :class:`Cause`.
    """
    _register_installed()
    result: dict[str, Cause] = {}
    for kind, cause in CAUSES.items():
        if cause.regroups and not regrouping:
            continue
        if cause is CHANGED:
            placed = changed_causes(system)
        elif kind in EFFECTS:
            placed = [cause.at(p, system) for p in place(EFFECTS[kind], system)]
        elif cause is BODY_PUSH:
            placed = [cause.on_body(k, place) for k, place in enumerate(system.push_places)]
        else:
            placed = [cause.on_joint(j, system) for j in system.loaded_joints]
        result |= {c.name: c for c in placed}
    return result


__all__ = [
    "CAUSES",
    "Cause",
    "Hint",
    "Motion",
    "UnknownCauseError",
    "catalogue",
    "causes_named",
    "changed_parameter",
    "is_changed",
    "kind_of",
    "measured_channels",
    "register_cause",
    "shown_causes",
]
