"""Tolerance of a cause: the amount of it that any healthy machine has.

No model is exact. Loads, gains and readings of a healthy machine differ a little from every simulation, clocks run
apart by some parts per million, and samples are stamped a little early or late. With sensors of low noise, such amounts
are significant. They are no fault, so a cause of which the log shows no more is not named.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from deepkoco.systems import Parameter

# The declared standard deviation of an effect's parameter is the size of a usual small fault: 20 % of a joint's typical
# load for dry friction. A healthy machine has this share of it, so its friction is known to 0.05 % of that load.
SHARE_OF_USUAL = 2.5e-3
LOAD_SHARE = 5e-4  # of a joint's typical load
MOVING_SHARE = 5e-3  # of that load, which a friction that grows with the speed may add at the joint's speed
PUSH_LASTS = 1.0  # a load of that share may act for so long [s]; a shorter one may be stronger
CLOCK_RATE = 5e-5  # crystal clocks differ by 20 to 50 parts per million
LEAD_SHARE = (
    0.5  # of the sample period, by which commands may act before their stamps: nothing acts before it is sent
)
SAMPLE_SHARE = 0.01  # of the sample period, by which stamps are early or late
# Times those tolerances of a machine of which only a model file is known: 0.5 % of the load.
OF_MODEL_FILE = 10.0
BESIDE_HEALTHY = 3.0  # times them beside healthy logs, which are of other motions and another day
USUAL, USUAL_FRICTION = (
    0.02,
    0.1,
)  # standard deviations by which units of one make differ, in shares of a parameter


class Healthy(NamedTuple):
    """What the tolerance of one parameter may depend on.

    Attributes:
        parameter: Its declaration.
        load: Typical load of the joint of the cause [N m or N].
        period: Sample period of the log [s].
        values: Fitted values of all parameters.
        speed: Root mean square of the joint's speed in the log [rad/s or m/s]; 0 where nothing says it.
    """

    parameter: Parameter
    load: float
    period: float
    values: dict[str, float]
    speed: float = 0.0


Tolerance = Callable[[Healthy], float]


def share_of_usual(healthy: Healthy) -> float:
    """Return a share of the size of a usual small fault."""
    return SHARE_OF_USUAL * healthy.parameter.prior_sd


def share_at_speed(power: int) -> Tolerance:
    """Return the tolerance of a friction that grows with a power of the speed.

    The size of a usual small fault is that of a joint that moves at 1 rad/s. A wheel at 60 rad/s meets sixty times that
    load, or 3,600 times; no healthy machine has so much.

    Args:
        power: Of the speed.
    """

    def tolerance(healthy: Healthy) -> float:
        most = MOVING_SHARE * healthy.load / max(healthy.speed, 1e-9) ** power
        return min(share_of_usual(healthy), most)

    return tolerance


def of_data_sheet(healthy: Healthy) -> float:
    """Return the declared standard deviation of a parameter of the machine itself; of a guessed one, the usual."""
    return usual_sd(healthy.parameter) if healthy.parameter.guessed else healthy.parameter.prior_sd


def usual_sd(parameter: Parameter) -> float:
    """Return the standard deviation by which units of one make differ in a parameter.

    It is 2 % of a parameter and 10 % of a friction. One that is 0 has a tenth of its declared one, and one that may
    have either sign at least that: a centre of mass 2 mm beside its axis is no better known than one on it. A friction
    has no sign, also where its bounds leave a fit room below zero.
    """
    rubs = (
        "friction" in f"{parameter.name} {parameter.description}"
        or "s/rad" in parameter.unit
        or "s/m" in parameter.unit
    )
    share = USUAL_FRICTION if rubs else USUAL
    signed = parameter.low < 0.0 < parameter.high and not rubs
    least = 0.1 * parameter.prior_sd if signed or not parameter.value else 0.0
    return max(share * abs(parameter.value), least)


def of_clock(healthy: Healthy) -> float:
    """Return the difference of the rates of two crystal clocks."""
    return CLOCK_RATE


def of_sample(healthy: Healthy) -> float:
    """Return a share of the sample period [s]."""
    return SAMPLE_SHARE * healthy.period


def of_stamps(healthy: Healthy) -> float:
    """Return the part of a sample period by which stamps are rounded [s]."""
    return LEAD_SHARE * healthy.period


def of_force_impulse(healthy: Healthy) -> float:
    """Return the force whose impulse is that of a share of the typical load for one second."""
    return LOAD_SHARE * healthy.parameter.prior_sd * max(PUSH_LASTS / healthy.values["event.duration"], 1.0)


def of_impulse(healthy: Healthy) -> float:
    """Return the load whose impulse is that of a share of the typical load for one second."""
    lasts = healthy.values["event.duration"]
    return LOAD_SHARE * healthy.load * max(PUSH_LASTS / lasts, 1.0)
