"""A parameter of the simulation that has another value on the machine: a cause for every parameter of a system."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint, Starts, from_null
from deepkoco.diagnose.causes.tolerance import of_data_sheet
from deepkoco.systems import Parameter, System
from deepkoco.systems.trees.force_limits import is_force_limit

FAMILY = "parameter"
# The prior of a changed parameter says hardly more than its bounds: so many declared standard deviations, and at least
# this share of its value.
WIDER = 10.0
LEAST_SHARE = 0.5
# Of a limit, from which its other value is searched for: one that cuts nothing off has no slope.
SHARES_OF_LIMIT = (1.0, 0.6, 0.36, 0.22, 0.13, 0.08)

CHANGED = Cause(
    "changed",
    FAMILY,
    (),
    "A parameter of the simulation has another value on the machine.",
    "Measure this parameter by itself: weigh a body, read a setting of the drive, or look it up in the data sheet.",
    "time",
    lambda motion: np.zeros_like(motion.time),
    tolerance=of_data_sheet,
)


SCALED = Cause(
    "scaled",
    FAMILY,
    ("factor",),
    "All parameters of a kind differ by the same factor, as when the supply sags or the gears are cold.",
    "Measure one of them by itself, or measure what all have in common: the supply voltage, the temperature.",
    "time",
    lambda motion: np.zeros_like(motion.time),
    lambda hint: [{"factor": factor} for factor in (1.0, 0.6, 1.6)],
)


def changed_causes(system: System) -> list[Cause]:
    """Return a cause for every parameter of a plain system; its estimate is the parameter's new value."""
    return [
        replace(
            CHANGED, name=f"{CHANGED.name}({p.name})", free=(p.name,), effect=CHANGED.name, starts=_starts(p)
        )
        for p in system.parameters
        if "." not in p.name
    ]


def _starts(parameter: Parameter) -> Starts:
    if not is_force_limit(parameter.name):
        return from_null

    def starts(hint: Hint) -> list[dict[str, float]]:
        del hint
        shares = (max(share * parameter.value, parameter.low) for share in SHARES_OF_LIMIT[1:])
        return [{}, *({parameter.name: limit} for limit in shares)]

    return starts


def is_changed(cause: Cause) -> bool:
    """Return whether a cause is another value of one of the simulation's own parameters."""
    return cause.effect == CHANGED.name


def changed_parameter(name: str) -> str | None:
    """Return the parameter that a name of a cause speaks of (``changed(mass)``: ``mass``); None for other causes."""
    head = f"{CHANGED.name}("
    return name[len(head) : -1] if name.startswith(head) else None


def widened(parameter: Parameter) -> Parameter:
    """Return a parameter with the wide prior of one that may have changed."""
    return replace(parameter, prior_sd=max(WIDER * parameter.prior_sd, LEAST_SHARE * abs(parameter.value)))
