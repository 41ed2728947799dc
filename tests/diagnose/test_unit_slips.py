"""Slips of units: tried wherever a wrong unit could be, also where the refit of the baseline absorbs it."""

import math
from dataclasses import replace

import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.slips import LARGE, SLIPS, slipped, states_read_by
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit import FitProblem, cut_windows, window_length
from deepkoco.logs.recording import Recording
from deepkoco.systems import make_system
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


@pytest.mark.parametrize(
    ("shows", "logged", "channel", "read"),
    [
        ((0, 1), (True, True), 1, [1, 3]),
        ((0, 1, 3), (True, True, True), 1, [1]),
        ((0, 1, 3), (True, True, True), 2, [3]),
        ((0, 1, 2, 3), (True, True, True, False), 1, [1, 3]),  # declared, and not in the log
    ],
)
def test_a_unit_is_wrong_of_the_speed_too_that_a_position_alone_shows(shows, logged, channel, read):
    assert states_read_by(shows, logged, channel, joints=2) == read


def test_few_windows_choose_the_right_one_of_many_constants():
    log = rescaled(hidden_log("rod_pendulum", {}, "steps", 7, 60.0), "theta", 180.0 / math.pi)
    system = make_system("rod_pendulum")
    windows = cut_windows([log], system, window_length(system))
    start = baseline_from(system, windows)
    windows, reference = refit_sharply(start, windows)
    known = catalogue(system)
    hints = Hints(system, windows, missing_torque(FitProblem(start.system, windows), reference), math.inf)
    causes = [c for c in known.values() if not c.free and c.scatter is None and not c.traced]
    offered = [(c, place) for c in causes for place in c.starts(hints.for_cause(c))]
    assert len(offered) * len(windows) > LARGE
    trials = slipped(FitProblem(start.system, windows), start, (), reference, offered, math.inf)
    assert len(trials) == SLIPS
    assert trials[0].name == "channel_slip(theta)"
