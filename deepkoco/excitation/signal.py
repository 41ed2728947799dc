"""What an excitation is: a command from time and the last measurement."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from deepkoco.systems import JointSystem, System

Excitation = Callable[[float, Sequence[float]], float]
"""(time since the start [s], last measurement in the order of the system's measurements) -> command"""


class ExcitationError(ValueError):
    """An excitation is unknown, or asks for more than the unit takes."""


def natural_frequency(system: System) -> float:
    """Small oscillations of the nominal system about hanging [rad/s]."""
    assert isinstance(system, JointSystem)
    return math.sqrt(system.load_scale / float(system.inertia(system.default_parameters())))
