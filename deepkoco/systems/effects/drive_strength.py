"""A drive that is weaker or stronger than its model: one factor on all of its force.

The force of a servo answers its goal, the position and the speed of its joint:

    force = k (kp (u - q) - kv q' + b0).

A low supply voltage, a hot magnet or a motor of another size changes all terms alike. A ``gain`` changes the goal u
alone: for a servo that is another angle, not another force. Of a motor both are the same, and the effect is left to
``gain``.

Source: Siciliano, Sciavicco, Villani, Oriolo, Robotics: Modelling, Planning and Control (2009), section 5.2: the torque
    of an electric drive is its torque constant times its current.
"""

from __future__ import annotations

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System


def _drive_strength(system: System, command: int = 0) -> tuple[Parameter, ...]:
    if len(system.drive_parameters[command]) < 2:
        return ()  # another value of the only parameter, or another gain, is the same
    return (Parameter("factor", 1.0, "1", 0.05, 20.0, 0.3, "k, force of the drive over that of its model"),)


def _apply_drive_strength(system: System, command: int, parameters: Parameters, p: Parameters) -> Parameters:
    names = system.drive_parameters[command]
    return {**parameters, **{n: p["factor"] * parameters[n] for n in names}}


DRIVE_STRENGTH = Effect(
    "drive_strength",
    "actuator",
    "body",
    _drive_strength,
    "all of the force of a drive differs by one factor",
    _apply_drive_strength,
    "command",
)
