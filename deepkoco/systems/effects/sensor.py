"""Sensor effects: what happens to a measurement."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import Effect, SensorSite
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System

LONG = 30.0  # time over which a drift is judged [s]
BRIEFEST, LONGEST = 1e-3, 5.0  # in which a sensor's zero moves [s]


def _changed(measurement: Tensor, channels: tuple[int, ...], change: Callable[[Tensor], Tensor]) -> Tensor:
    parts = list(measurement.unbind(-1))
    for c in channels:
        parts[c] = change(parts[c])
    return torch.stack(torch.broadcast_tensors(*parts), -1)


def _bias(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    unit = system.state_units[joint]
    return (Parameter("angle", 0.0, unit, -0.5, 0.5, 0.1, "q0, zero error of the position sensor"),)


def _apply_bias(measurement: Tensor, site: SensorSite, p: Parameters) -> Tensor:
    return _changed(measurement, site.positions, lambda x: x + p["angle"])


def _speed_bias(system: System, channel: int = 0) -> tuple[Parameter, ...]:
    """A gyro or a tachometer, alone or beside an encoder."""
    states = system.measured_states if system.shows_states else ()
    if channel >= len(states) or not system.joints <= states[channel] < 2 * system.joints:
        return ()
    unit = system.state_units[states[channel]]
    return (
        Parameter("speed", 0.0, unit, -0.5, 0.5, 0.05, "w0, speed that the sensor shows of a joint at rest"),
    )


def _apply_speed_bias(measurement: Tensor, site: SensorSite, p: Parameters) -> Tensor:
    return _changed(measurement, site.positions + site.speeds, lambda x: x + p["speed"])


def _scale(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    return (Parameter("factor", 1.0, "1", 0.3, 3.0, 0.1, "k_s, reading per true value"),)


def _apply_scale(measurement: Tensor, site: SensorSite, p: Parameters) -> Tensor:
    return _changed(measurement, site.positions + site.speeds, lambda x: x * p["factor"])


def sensors_beside(system: System, channel: int) -> tuple[int, ...]:
    """Return the other channels that show the joint of a channel; all others where channels do not show states."""
    others = tuple(c for c in range(len(system.measurements)) if c != channel)
    if not system.shows_states:
        return others
    joints = [state % system.joints for state in system.measured_states]
    return tuple(c for c in others if joints[c] == joints[channel])


def _channel_scale(system: System, channel: int = 0) -> tuple[Parameter, ...]:
    if not sensors_beside(system, channel):
        return ()  # there it is the scale of all readings of the joint
    text = "k_c, reading per true value, beside the other sensors of the joint"
    return (Parameter("factor", 1.0, "1", 0.3, 3.0, 0.1, text),)


def _drift(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    unit = system.state_units[system.joints + joint]
    limit = 3.0 / LONG
    return (Parameter("rate", 0.0, unit, -limit, limit, 0.1 * limit, "drift of the position sensor's zero"),)


def _apply_drift(measurement: Tensor, site: SensorSite, p: Parameters) -> Tensor:
    if site.time is None:
        if not bool((p["rate"] != 0.0).any()):
            return measurement
        raise ValueError("a sensor's drift needs the time; it can be simulated along a log only")
    time = site.time
    return _changed(measurement, site.positions, lambda x: x + p["rate"] * time)


def _ripple(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    if system.state_units[joint] != "rad":
        return ()  # what slides has no turns
    return (
        Parameter("sine", 0.0, "rad", -0.5, 0.5, 0.01, "e_s, error of the reading with sin(n q)"),
        Parameter("cosine", 0.0, "rad", -0.5, 0.5, 0.01, "e_c, error of the reading with cos(n q)"),
        Parameter("cycles", 1.0, "1", 1.0, 64.0, 1.0, "n, times per turn"),
    )


def _apply_ripple(measurement: Tensor, site: SensorSite, p: Parameters) -> Tensor:
    """Readings q + e_s sin(n q) + e_c cos(n q), and speeds as their derivative where a position shows the angle."""
    if not site.positions:
        return measurement
    n = p["cycles"]
    phase = n * measurement[..., site.positions[0]]
    sine, cosine = torch.sin(phase), torch.cos(phase)
    slope = 1.0 + n * (p["sine"] * cosine - p["cosine"] * sine)
    shown = _changed(measurement, site.positions, lambda x: x + p["sine"] * sine + p["cosine"] * cosine)
    return _changed(shown, site.speeds, lambda w: w * slope)


def _shift(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    unit = system.state_units[joint]
    return (
        Parameter("angle", 0.0, unit, -10.0, 10.0, 0.1, "by how much the zero of the position sensor moves"),
        Parameter("start", 0.0, "s", 0.0, 1e6, 1.0, "when it begins to move, since the log's first command"),
        Parameter("duration", 0.05, "s", BRIEFEST, LONGEST, 0.1, "how long it moves"),
    )


def _apply_shift(measurement: Tensor, site: SensorSite, p: Parameters) -> Tensor:
    if site.time is None:
        if not bool((p["angle"] != 0.0).any()):
            return measurement
        raise ValueError("a shift of a sensor's zero needs the time; it can be simulated along a log only")
    moved = p["angle"] * ((site.time - p["start"]) / p["duration"]).clamp(0.0, 1.0)
    return _changed(measurement, site.positions, lambda x: x + moved)


def _slip(system: System, channel: int = 0) -> tuple[Parameter, ...]:
    text = "c, reading per true value: a constant between units"
    return (Parameter("factor", 1.0, "1", -2000.0, 2000.0, 1.0, text),)


def _apply_slip(measurement: Tensor, site: SensorSite, p: Parameters) -> Tensor:
    return _changed(measurement, site.positions + site.speeds, lambda x: x * p["factor"])


def _low_pass(system: System, _: int = 0) -> tuple[Parameter, ...]:
    return (Parameter("time_constant", 0.0, "s", 0.0, 0.3, 0.05, "T_s, first-order filter of the sensors"),)


def _sensor_crosstalk(system: System, pair: int = 0) -> tuple[Parameter, ...]:
    source, joint = system.shown_pairs[pair]
    units = system.state_units[joint], system.state_units[source]
    per = "1" if units[0] == units[1] else f"{units[0]}/{units[1]}"
    text = "c_s, reading of this joint per position of that"
    return (Parameter("share", 0.0, per, -1.0, 1.0, 0.1, text),)


def _apply_sensor_crosstalk(measurement: Tensor, site: SensorSite, p: Parameters) -> Tensor:
    own = measurement.unbind(-1)
    for channels, (source, *_) in ((own_c, o) for own_c, o in zip(site[:2], site.others, strict=True) if o):
        measurement = _changed(measurement, channels, lambda x, of=own[source]: x + p["share"] * of)
    return measurement


SENSOR_BIAS = Effect(
    "sensor_bias", "sensor", "sensor", _bias, "the position sensor's zero is off", _apply_bias
)
SPEED_BIAS = Effect(
    "speed_bias",
    "sensor",
    "sensor",
    _speed_bias,
    "the speed sensor's zero is off",
    _apply_speed_bias,
    "channel",
)
SENSOR_SCALE = Effect(
    "sensor_scale", "sensor", "sensor", _scale, "the sensor's readings are scaled", _apply_scale
)
CHANNEL_SCALE = Effect(
    "channel_scale",
    "sensor",
    "sensor",
    _channel_scale,
    "one of several sensors of a joint is scaled",
    _apply_slip,
    "channel",
)
SENSOR_CROSSTALK = Effect(
    "sensor_crosstalk",
    "sensor",
    "sensor",
    _sensor_crosstalk,
    "what shows one joint shows a share of another one too",
    _apply_sensor_crosstalk,
    "shown pair",
)
SENSOR_DRIFT = Effect(
    "sensor_drift", "sensor", "sensor", _drift, "the position sensor's zero drifts", _apply_drift
)
SENSOR_RIPPLE = Effect(
    "sensor_ripple", "sensor", "sensor", _ripple, "the readings err with the angle", _apply_ripple
)
SENSOR_SHIFT = Effect(
    "sensor_shift", "sensor", "sensor", _shift, "the position sensor's zero moves once", _apply_shift
)
CHANNEL_SLIP = Effect(
    "channel_slip",
    "unit",
    "sensor",
    _slip,
    "a channel is logged in another unit",
    _apply_slip,
    "channel",
)
LOW_PASS = Effect(
    "low_pass",
    "sensor",
    "timing",
    _low_pass,
    "the sensors filter what they measure",
    site="system",
)
