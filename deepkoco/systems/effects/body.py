"""Body effects: what the robot carries."""

from __future__ import annotations

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.system import Parameter, Parameters, System


def _payload(system: System) -> tuple[Parameter, ...]:
    # The mass whose weight one metre from the joint equals the joint's typical torque.
    scale = system.load_scale / 9.81
    return (Parameter("mass", 0.0, "kg", 0.0, 20.0 * scale, scale, "m_p, point mass at the tip"),)


def _apply_payload(system: System, parameters: Parameters, p: Parameters) -> Parameters:
    return system.with_payload(p["mass"], parameters)


PAYLOAD = Effect("payload", "body", "body", _payload, "a point mass is fixed to the tip", _apply_payload)
