"""What an effect is: a nested extension of a system at one place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from deepkoco.systems.joint import JointSystem
from deepkoco.systems.system import Parameter

Place = Literal["command", "timing", "load", "body", "sensor"]


def _carried_out_by_the_runtime(*_: Any) -> Any:
    raise TypeError("a timing effect is a delay: it has no equation to apply")


@dataclass(frozen=True)
class Effect:
    """Extra physics whose parameters have null values that recover the system without it exactly.

    Attributes:
        name: Name of the effect.
        family: Group it is reported in: timing, friction, actuator, sensor or body.
        place: Where it acts, which fixes the signature of ``apply`` (``p`` holds this effect's own
            parameters by their short names, each scalar or of the batch shape):

            - ``command``: ``apply(command, p) -> effort``, memoryless;
            - ``load``: ``apply(omega, p) -> torque`` [N m] on the joint;
            - ``body``: ``apply(system, parameters, p) -> parameters``;
            - ``sensor``: ``apply(measurement (..., N), p) -> measurement``;
            - ``timing``: no ``apply``; its value is a time [s] that the runtime carries out.
        parameters: Declares the parameters for a system; their ``value`` is the null value.
        apply: The physics.
        summary: One sentence for reports.
    """

    name: str
    family: str
    place: Place
    parameters: Callable[[JointSystem], tuple[Parameter, ...]]
    summary: str
    apply: Callable[..., Any] = _carried_out_by_the_runtime
