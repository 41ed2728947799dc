"""Slips of units: tried wherever a wrong unit could be, also where the refit of the baseline absorbs it."""

import math
from dataclasses import replace

import pytest

from deepkoco.diagnose import diagnose
from deepkoco.logs.recording import Recording
from tests.oracle.unit import hidden_log

RIVALS = ("gain", "length", "payload", "coulomb", "unit_slip", "channel_slip(theta)")


def rescaled(log: Recording, channel: str, factor: float) -> Recording:
    """The log with one channel's values times a factor."""
    series = log.channels[channel]
    return replace(log, channels={**log.channels, channel: replace(series, value=factor * series.value)})


@pytest.mark.study
@pytest.mark.parametrize(("excitation", "seed"), [("steps", 120), ("chirp", 5)])
def test_unit_slip_that_the_refit_absorbs_is_named(excitation, seed):
    # A lighter rod answers as a larger torque does, so the refit leaves nothing but noise: chi2 is 1.04.
    log = rescaled(hidden_log("rod_pendulum", {}, excitation, seed, 20.0), "torque", math.pi / 180.0)
    result = diagnose([log], "rod_pendulum", only=RIVALS)
    assert result.chi2_before < 1.5
    assert result.verdict == "cause"
    assert result.causes[0].name == "unit_slip"
    assert result.causes[0].parameters["unit_slip.factor"].value == pytest.approx(180.0 / math.pi)
