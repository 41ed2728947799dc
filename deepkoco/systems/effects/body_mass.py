"""A body of another mass in the same shape: other metal, a motor or a cover that its model leaves out."""

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System


def _body_mass(system: System, body: int = 0) -> tuple[Parameter, ...]:
    return (
        Parameter("factor", 1.0, "1", 0.05, 20.0, 0.3, "k_m, mass and moments of inertia per assumed ones"),
    )


def _apply_body_mass(system: System, body: int, parameters: Parameters, p: Parameters) -> Parameters:
    own = list(system.bodies.values())[body]
    return {**parameters, **{n: p["factor"] * parameters[n] for n in own if n in parameters}}


BODY_MASS = Effect(
    "body_mass",
    "body",
    "body",
    _body_mass,
    "a body is heavier or lighter than assumed, in the same shape",
    _apply_body_mass,
    "body",
)
