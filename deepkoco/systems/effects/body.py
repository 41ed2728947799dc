"""Body effects: what the robot is made of, carries, and how it stands."""

from __future__ import annotations

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.motion import PayloadWay
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System


def _payload(system: System, place: int = 0) -> tuple[Parameter, ...]:
    if place == 0 and not system.takes_payload:
        return ()
    # The mass whose weight one metre from the joint equals the joint's typical torque.
    scale = system.load_scale / 9.81
    where = "at the tip" if place == 0 else f"at {system.payload_sites[place - 1]}"
    site, way = _site_and_way(system, place)
    if way is not None:
        where = f"on {site}"
    # An arm may be as short as 3 cm, and carry several times the load that it has usually.
    mass = Parameter("mass", 0.0, "kg", 0.0, 100.0 * scale, scale, f"m_p, point mass {where}")
    if way is None:
        return (mass,)
    text = f"s_p, from the joint of {site} to the point mass, along the link"
    return mass, Parameter("along", way.at, "m", way.low, way.high, way.sd, text)


def _site_and_way(system: System, place: int) -> tuple[str | None, PayloadWay | None]:
    site = system.tip if place == 0 else system.payload_sites[place - 1]
    return site, None if site is None else system.payload_way(site)


def _apply_payload(system: System, place: int, parameters: Parameters, p: Parameters) -> Parameters:
    site, way = _site_and_way(system, place)
    if way is not None:
        assert site is not None
        return system.with_payload_at(site, p["mass"], parameters, p["along"])
    if place == 0:
        return system.with_payload(p["mass"], parameters)
    return system.with_payload_at(system.payload_sites[place - 1], p["mass"], parameters)


def _length(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    declared = Parameter("factor", 1.0, "1", 0.3, 3.0, 0.1, "k_l, length of the link per assumed length")
    return (declared,) if system.resizable else ()


def _apply_length(system: System, joint: int, parameters: Parameters, p: Parameters) -> Parameters:
    return system.with_length(p["factor"], joint, parameters)


def _tilt(system: System, _: int = 0) -> tuple[Parameter, ...]:
    return system.tilt_parameters


def _apply_tilt(system: System, _: int, parameters: Parameters, p: Parameters) -> Parameters:
    return {**parameters, **p}


def _force(system: System, place: int = 0) -> tuple[Parameter, ...]:
    return system.force_parameters(system.force_sites[place])


def _apply_force(system: System, place: int, parameters: Parameters, p: Parameters) -> Parameters:
    return system.with_force_at(system.force_sites[place], p, parameters)


PAYLOAD = Effect(
    "payload", "body", "body", _payload, "a point mass is fixed to the tip", _apply_payload, "place"
)
LENGTH = Effect("length", "body", "body", _length, "a link is longer or shorter than assumed", _apply_length)
TILT = Effect("tilt", "body", "body", _tilt, "the base is tilted against gravity", _apply_tilt, "system")
FORCE = Effect(
    "force",
    "body",
    "body",
    _force,
    "a constant force of the world pulls at a body",
    _apply_force,
    "force place",
)
