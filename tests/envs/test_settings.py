"""Which models an environment on the delay graph takes."""

import re

import pytest

from deepkoco.envs.settings import EnvironmentSettings, SettingsError
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.effects import effects_of

BASE = make_system("rod_pendulum")
ALONG_A_LOG = {
    "backlash",
    "gain_drift",
    "periodic",
    "sensor_drift",
    "sensor_shift",
}  # they need the past, or the time


def extended(name: str) -> ExtendedSystem:
    """The rod pendulum with an effect at a third of the way to its bounds."""
    declared = effects_of(BASE)[name].parameters(BASE)
    return ExtendedSystem(
        BASE, (name,), {f"{name}.{p.name}": p.value + (p.high - p.value) / 3 for p in declared}
    )


@pytest.mark.parametrize("name", sorted(effects_of(BASE)))
def test_a_model_that_acts_along_a_log_only_is_refused_before_an_episode_begins(name):
    if name not in ALONG_A_LOG:
        EnvironmentSettings("rod_pendulum", model=extended(name)).make_system()
        return
    with pytest.raises(SettingsError, match=r"cannot be simulated step by step: .*leave that effect out"):
        EnvironmentSettings("rod_pendulum", model=extended(name))


@pytest.mark.parametrize("name", sorted(ALONG_A_LOG))
def test_such_an_effect_at_its_null_value_is_taken(name):
    EnvironmentSettings("rod_pendulum", model=ExtendedSystem(BASE, (name,)))


@pytest.mark.parametrize("name", ["low_pass", "channel_delay(theta)"])
def test_what_a_model_says_of_the_sensors_alone_is_left_out_with_a_warning(name):
    with pytest.warns(UserWarning, match=re.escape(name)):
        EnvironmentSettings(model=extended(name))


def test_a_delay_of_all_speeds_is_left_out_under_its_own_name():
    late = ExtendedSystem(make_system("two_link_arm"), ("speed_delay",), {"speed_delay.delay": 0.02})
    with pytest.warns(UserWarning, match="leaves out speed_delay of the model"):
        EnvironmentSettings("two_link_arm", model=late)
