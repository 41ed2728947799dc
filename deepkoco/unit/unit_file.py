"""UNIT.yaml read, completed with nominal values and checked against the system."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from deepkoco.systems import (
    JOINT_SYSTEMS,
    SYSTEMS,
    Channel,
    JointCountError,
    JointSystem,
    Parameter,
    one_joint,
)
from deepkoco.systems.effects import EFFECTS
from deepkoco.unit.spec import SensorSpec, UnitSpec
from deepkoco.yaml_file import YamlFileError, read_yaml, shown

DELAYS = ("actuation_delay", "sensing_delay")
# What the plant of a unit carries out; the simulation knows more effects.
CARRIED = (
    *DELAYS,
    "lag",
    "viscous",
    "coulomb",
    "stribeck",
    "quadratic",
    "lost_commands",
    "gain",
    "gain_curve",
    "torque_bias",
    "dead_zone",
    "saturation",
    "payload",
    "sensor_scale",
    "sensor_bias",
    "event",
    "cogging",
)
KEYS = (
    "system",
    "parameters",
    "effects",
    "sensor",
    "initial_state",
    "friction_smoothing",
    "heartbeat",
    "seed",
)
SENSOR_KEYS = ("rate_hz", "noise_sd", "quantisation")
DEFAULT_RATE = 100.0  # [Hz]


class UnitSpecError(ValueError):
    """A unit is described wrongly; the message names the file, the key and what is known there."""


class _Bound(NamedTuple):
    """One parameter of an effect: its value where the file gives none, its limits, its unit."""

    value: float | None
    low: float
    high: float
    unit: str


def load_unit(path: str | Path, system: str | None = None) -> UnitSpec:
    """Read UNIT.yaml.

    Args:
        path: The file.
        system: System that the caller wants; the file may leave its own ``system`` out, and an error is
            raised where the two differ.

    Raises:
        UnitSpecError: The file cannot be read or describes no unit.
    """
    path = Path(path)
    try:
        content = read_yaml(path)
    except YamlFileError as error:
        raise UnitSpecError(str(error)) from error
    content = _keys(content if content is not None else {}, KEYS, str(path))
    named = content.pop("system", None)
    if system is not None and named is not None and named != system:
        raise UnitSpecError(f'{path}: system: the file describes a "{named}", asked for "{system}"')
    chosen = system or named
    if chosen is None:
        raise UnitSpecError(f"{path}: system: missing; known: {', '.join(sorted(JOINT_SYSTEMS))}")
    return make_unit(chosen, name=path.stem, source=str(path), **content)


def make_unit(
    system: str,
    *,
    effects: Mapping[str, Mapping[str, Any]] | None = None,
    parameters: Mapping[str, float] | None = None,
    sensor: Mapping[str, Any] | None = None,
    initial_state: Sequence[float] | None = None,
    friction_smoothing: float = 0.0,
    heartbeat: float = 0.5,
    seed: int = 0,
    name: str = "unit",
    source: str = "unit",
) -> UnitSpec:
    """Unit of a system, with nominal values for whatever is not given.

    Args:
        system: Name of the system.
        effects: Hidden effects (``CARRIED``) by the names and parameters of :mod:`deepkoco.systems.effects`, but
            ``event`` with ``torque``, ``start`` and ``duration``, and ``cogging`` by its height (``torque``,
            ``cycles``). A delay is a number or ``{mean, sd}``, all in seconds.
        parameters: True values that differ from the nominal ones.
        sensor: ``rate_hz``, and ``noise_sd`` and ``quantisation`` by channel.
        initial_state: Angle [rad] and speed [rad/s] at power-on; None takes hanging at rest.
        friction_smoothing: Width of the sign of dry friction [rad/s]; 0 for true sticking.
        heartbeat: Longest time without a command [s].
        seed: Seed of noise and jitter.
        name: Name of the unit.
        source: What error messages call the place of the description.

    Raises:
        UnitSpecError: A name is unknown or a value is out of bounds.
    """
    if not isinstance(system, str) or system not in SYSTEMS:
        raise UnitSpecError(
            f'{source}: system: unknown system "{system}"; known: {", ".join(sorted(JOINT_SYSTEMS))}'
        )
    try:
        base = one_joint(system)
    except JointCountError as error:
        raise UnitSpecError(f"{source}: system: {error}") from error
    spec = UnitSpec(
        name=name,
        system=system,
        parameters=_parameters(base, parameters, source),
        effects={
            effect: _effect(base, effect, given, source)
            for effect, given in _keys(effects or {}, _known_effects(), f"{source}: effects").items()
        },
        sensor=_sensor(base.measurements, sensor or {}, source),
        command_limits=(base.command.low, base.command.high),
        initial_state=_initial_state(base, initial_state, source),
        friction_smoothing=_number(friction_smoothing, f"{source}: friction_smoothing", 0.0, 10.0, "rad/s"),
        heartbeat=_number(heartbeat, f"{source}: heartbeat", 0.01, 60.0, "s"),
        seed=_seed(seed, f"{source}: seed"),
    )
    _refuse_negative_friction(spec, source)
    return spec


def _known_effects() -> tuple[str, ...]:
    return CARRIED


def _effect_bounds(system: JointSystem, effect: str) -> dict[str, _Bound]:
    scale = system.load_scale
    if effect == "event":
        return {
            "torque": _Bound(None, -10 * scale, 10 * scale, "N m"),
            "start": _Bound(None, 0.0, math.inf, "s"),
            "duration": _Bound(None, 0.0, math.inf, "s"),
        }
    if effect == "cogging":
        return {
            "torque": _Bound(None, -10 * scale, 10 * scale, "N m"),
            "cycles": _Bound(None, 1.0, 1000.0, "1"),
        }
    declared: tuple[Parameter, ...] = EFFECTS[effect].parameters(system)
    # An effect of one parameter says nothing without it; one of several may leave some at their null.
    alone = len(declared) == 1
    return {p.name: _Bound(None if alone else p.value, p.low, p.high, p.unit) for p in declared}


def _effect(system: JointSystem, effect: str, given: Any, source: str) -> dict[str, float]:
    where = f"{source}: effects.{effect}"
    bounds = _effect_bounds(system, effect)
    given = _keys(given, tuple(bounds), where)
    if effect in DELAYS and isinstance(given.get("delay"), Mapping):
        law = _keys(given["delay"], ("mean", "sd"), f"{where}.delay")
        mean = law.get("mean")
        if mean is None:
            raise UnitSpecError(f"{where}.delay.mean: missing; give the mean in s")
        jitter_sd = _number(law.get("sd", 0.0), f"{where}.delay.sd", 0.0, bounds["delay"].high, "s")
        given = {"delay": mean}
    else:
        jitter_sd = 0.0
    values = {}
    for name, bound in bounds.items():
        value = given.get(name, bound.value)
        if value is None:
            raise UnitSpecError(f"{where}.{name}: missing; give a value in {bound.unit}")
        values[name] = _number(value, f"{where}.{name}", bound.low, bound.high, bound.unit)
    if effect in DELAYS:
        values["jitter_sd"] = jitter_sd
    return values


def _parameters(system: JointSystem, given: Any, source: str) -> dict[str, float]:
    declared = {p.name: p for p in system.parameters}
    given = _keys(given or {}, tuple(declared), f"{source}: parameters")
    return {
        name: _number(given.get(name, p.value), f"{source}: parameters.{name}", p.low, p.high, p.unit)
        for name, p in declared.items()
    }


def _sensor(channels: Sequence[Channel], given: Any, source: str) -> SensorSpec:
    where = f"{source}: sensor"
    given = _keys(given, SENSOR_KEYS, where)
    names = tuple(c.name for c in channels)
    noise = _keys(given.get("noise_sd") or {}, names, f"{where}.noise_sd")
    step = _keys(given.get("quantisation") or {}, names, f"{where}.quantisation")
    return SensorSpec(
        rate_hz=_number(given.get("rate_hz", DEFAULT_RATE), f"{where}.rate_hz", 1.0, 1000.0, "Hz"),
        noise_sd=tuple(
            _number(noise.get(c.name, c.noise_sd), f"{where}.noise_sd.{c.name}", 0.0, math.inf, c.unit)
            for c in channels
        ),
        quantisation=tuple(
            _number(step.get(c.name, 0.0), f"{where}.quantisation.{c.name}", 0.0, math.inf, c.unit)
            for c in channels
        ),
    )


def _initial_state(system: JointSystem, given: Any, source: str) -> tuple[float, float]:
    if given is None:
        upright: float = getattr(system, "upright", 0.0)
        return (math.pi - upright, 0.0)  # hanging at rest
    where = f"{source}: initial_state"
    if not isinstance(given, Sequence) or isinstance(given, str) or len(given) != 2:
        raise UnitSpecError(f"{where}: expected [angle in rad, speed in rad/s], got {shown(given)}")
    return (
        _number(given[0], f"{where}[0]", -math.inf, math.inf, "rad"),
        _number(given[1], f"{where}[1]", -math.inf, math.inf, "rad/s"),
    )


def _refuse_negative_friction(spec: UnitSpec, source: str) -> None:
    effects = spec.effects
    stribeck = effects.get("stribeck", {})
    dry = (
        spec.parameters.get("coulomb", 0.0)
        + effects.get("coulomb", {}).get("torque", 0.0)
        + stribeck.get("coulomb", 0.0)
    )
    viscous = spec.parameters["viscous"] + effects.get("viscous", {}).get("change", 0.0)
    drag = effects.get("quadratic", {}).get("drag", 0.0)
    for what, total, unit in (
        ("Coulomb friction", dry, "N m"),
        ("viscous friction", viscous, "N m s/rad"),
        ("quadratic drag", drag, "N m s2/rad2"),
    ):
        if total < 0.0:
            raise UnitSpecError(
                f"{source}: effects: the unit's {what} is {total:.4g} {unit} in sum, and friction that is "
                "negative drives the unit; raise it to 0 or more"
            )


def _keys(content: Any, known: Sequence[str], where: str) -> dict[str, Any]:
    if not isinstance(content, Mapping):
        raise UnitSpecError(
            f"{where}: expected keys and values, got {shown(content)}; known keys: {_list(known)}"
        )
    for key in content:
        if key not in known:
            raise UnitSpecError(f'{where}: unknown key "{key}"; known: {_list(known)}')
    return dict(content)


def _list(names: Sequence[str]) -> str:
    return ", ".join(names)


def _number(value: Any, where: str, low: float, high: float, unit: str) -> float:
    if isinstance(value, str):  # YAML takes 1e-3 for text
        with suppress(ValueError):
            value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UnitSpecError(f"{where}: expected a number in {unit}, got {shown(value)}")
    if not low <= value <= high:
        raise UnitSpecError(f"{where}: {value:g} {unit} is outside [{low:g}, {high:g}]")
    return float(value)


def _seed(value: Any, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise UnitSpecError(f"{where}: expected a whole number of 0 or more, got {shown(value)}")
    return value
