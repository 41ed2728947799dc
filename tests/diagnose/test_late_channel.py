"""One sensor of two is late."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.logs.recording import Recording
from tests.oracle.unit import hidden_log

pytestmark = pytest.mark.study


def older(log: Recording, channel: str, samples: int) -> Recording:
    """Stamp each reading of a channel some samples too late."""
    series = log.channels[channel]
    late = replace(series, t=series.t[samples:], value=series.value[:-samples])
    return replace(log, channels={**log.channels, channel: late})


def test_a_late_channel_is_named_with_its_delay():
    log = hidden_log("rod_pendulum", {}, "steps", 171, 20.0)
    period = float(log.channels["theta"].t[1] - log.channels["theta"].t[0])
    result = diagnose([older(log, "theta", 5)], "rod_pendulum")
    assert result.verdict in ("cause", "ambiguous")
    assert result.causes[0].name == "channel_delay(theta)"
    assert result.causes[0].parameters["channel_delay(theta).delay"].value == pytest.approx(
        5 * period, rel=0.05
    )
    assert result.chi2_after < 1.15


def test_speeds_that_a_drive_filters_are_named_as_one_delay_of_all_of_them():
    log = hidden_log("two_link_arm", {}, "steps", 172, 20.0)
    speeds = [name for name, own in log.channels.items() if own.unit == "rad/s"]
    period = float(np.diff(log.channels[speeds[0]].t).mean())
    for name in speeds:
        log = older(log, name, 3)
    result = diagnose([log], "two_link_arm")
    assert result.verdict == "cause"
    (found,) = result.causes
    assert found.name == "speed_delay"
    assert found.parameters["speed_delay.delay"].value == pytest.approx(3 * period, rel=0.05)
    assert result.chi2_after < 1.15
