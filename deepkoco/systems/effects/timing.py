"""Timing effects: delays, the actuator's first-order lag, clocks that run apart."""

from __future__ import annotations

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.parameter import Parameter
from deepkoco.systems.system import System

# A window of a fit is usually 1 to 2 s long, about one period of its system, and a delay or lag longer than the window
# would leave nothing to see in it. Thrusters, hydraulic valves and winches have lags of 0.3 to 1 s.
LONGEST = 1.0  # [s]
LONGEST_OF_CHANNEL = 0.5  # of receivers and cameras [s]
FASTEST_CLOCK = 5e-3  # relative
LONGEST_LEAD = 0.05  # [s]


def _actuation_delay(system: System, _: int = 0) -> tuple[Parameter, ...]:
    return (Parameter("delay", 0.0, "s", 0.0, LONGEST, 0.05, "tau_a, command sent to command acting"),)


def _sensing_delay(system: System, _: int = 0) -> tuple[Parameter, ...]:
    return (
        Parameter("delay", 0.0, "s", 0.0, LONGEST, 0.05, "tau_s, state to time stamp of its measurement"),
    )


def _channel_delay(system: System, channel: int = 0) -> tuple[Parameter, ...]:
    if len(system.measurements) < 2:
        return ()  # there it is the delay of all measurements
    text = "state to time stamp of this channel, beyond the delay of the others"
    return (Parameter("delay", 0.0, "s", 0.0, LONGEST_OF_CHANNEL, 0.05, text),)


def _speed_delay(system: System, _: int = 0) -> tuple[Parameter, ...]:
    shown = system.measured_states if system.shows_states else ()
    speeds = sum(system.joints <= state < 2 * system.joints for state in shown)
    if speeds < 2 or not any(state < system.joints for state in shown):
        return ()  # there it is the delay of one channel, or of all measurements
    text = "state to time stamp of every speed, beyond the delay of the positions"
    return (Parameter("delay", 0.0, "s", 0.0, LONGEST_OF_CHANNEL, 0.05, text),)


def _lag(system: System, _: int = 0) -> tuple[Parameter, ...]:
    return (Parameter("time_constant", 0.0, "s", 0.0, LONGEST, 0.05, "T, first-order lag of the actuator"),)


def _skew(system: System, _: int = 0) -> tuple[Parameter, ...]:
    text = "seconds that the sensor's clock gains on the commands' per second"
    return (Parameter("rate", 0.0, "1", -FASTEST_CLOCK, FASTEST_CLOCK, 5e-4, text),)


def _lead(system: System, _: int = 0) -> tuple[Parameter, ...]:
    text = "time by which commands act before their stamps, beside those of the measurements"
    return (Parameter("lead", 0.0, "s", 0.0, LONGEST_LEAD, 0.01, text),)


ACTUATION_DELAY = Effect(
    "actuation_delay",
    "timing",
    "timing",
    _actuation_delay,
    "commands act later than they are sent",
    site="command",
    shared=True,
)
SENSING_DELAY = Effect(
    "sensing_delay",
    "timing",
    "timing",
    _sensing_delay,
    "measurements are older than their time stamps",
    site="system",
)
CHANNEL_DELAY = Effect(
    "channel_delay",
    "timing",
    "timing",
    _channel_delay,
    "one channel is older than its time stamps",
    site="channel",
)
SPEED_DELAY = Effect(
    "speed_delay",
    "timing",
    "timing",
    _speed_delay,
    "speeds are older than their time stamps",
    site="system",
)
LAG = Effect(
    "lag",
    "timing",
    "timing",
    _lag,
    "the actuator follows its command as a first-order lag",
    site="command",
    shared=True,
)
CLOCK_SKEW = Effect(
    "clock_skew",
    "timing",
    "timing",
    _skew,
    "the clocks of commands and measurements run at different speeds",
    site="system",
)
STAMP_LEAD = Effect(
    "stamp_lead",
    "timing",
    "timing",
    _lead,
    "commands act before their time stamps",
    site="system",
)
