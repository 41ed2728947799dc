"""Type of an excitation: a function of time and the last measurement that gives a command."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from deepkoco.systems import JointSystem, System

Excitation = Callable[[float, Sequence[float]], float]
"""(time since the start [s], last measurement in the order of the system's measurements) -> command"""


class ExcitationError(ValueError):
    """An excitation is unknown, or its commands exceed the limits of the unit."""


def natural_frequency(system: System) -> float:
    """Angular frequency of small oscillations of the nominal system about the hanging position [rad/s]."""
    assert isinstance(system, JointSystem)
    return math.sqrt(system.load_scale / float(system.inertia(system.default_parameters())))
