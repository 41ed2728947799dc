"""One factor on a parameter that many joints, bodies or actuators have: a supply that sags, a grease that is cold."""

from __future__ import annotations

from deepkoco.systems.effects.effect import Effect, parameter_kinds
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System


def _scaled(system: System, kind: int = 0) -> tuple[Parameter, ...]:
    return (Parameter("factor", 1.0, "1", 0.05, 20.0, 0.3, "k, common factor of all of a kind"),)


def _apply_scaled(system: System, kind: int, parameters: Parameters, p: Parameters) -> Parameters:
    names = list(parameter_kinds(system).values())[kind]
    return {**parameters, **{n: p["factor"] * parameters[n] for n in names}}


SCALED = Effect(
    "scaled",
    "parameter",
    "body",
    _scaled,
    "all parameters of a kind differ by one factor",
    _apply_scaled,
    "kind",
)
