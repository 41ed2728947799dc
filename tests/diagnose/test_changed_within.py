"""A unit that is the simulated one until some time in its log, and then no longer."""

import math
from functools import cache

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.changed_within import change_within
from deepkoco.diagnose.explanation import SEEN_BEFORE
from deepkoco.diagnose.report.text import headline
from deepkoco.excitation.record import record
from deepkoco.fit.data.windows import cut_windows, moving
from deepkoco.logs.recording import part_of
from deepkoco.systems import make_system
from deepkoco.unit import make_unit
from tests.diagnose import two_units

SYSTEM = "torque_pendulum"


@cache
def log(seed, **effects):
    sizes = {name: {parameter: value} for name, (parameter, value) in effects.items()}
    unit = make_unit(SYSTEM, effects=sizes, sensor={"rate_hz": 100.0}, seed=seed)
    return record(unit, "steps", 15.0, clock="simulated", seed=seed)


def joined(first, second, at=15.0):
    return two_units.joined(first, second, at)


def change_in(recording):
    """Change within a log, of whose windows each fourth is held out."""
    system = make_system(SYSTEM)
    windows = cut_windows([recording], system, 1.0)
    windows = windows.take(moving(windows))
    own = np.arange(len(windows)) % 4 == 3
    train, held = windows.take(np.flatnonzero(~own)), windows.take(np.flatnonzero(own))
    start = baseline_from(system, train)
    return change_within(start, train, held, refit(start, train))


DRAGS = {"coulomb": ("torque", 0.1)}


def test_a_brake_that_begins_to_drag_is_seen_with_its_time():
    found = change_in(joined(log(1), log(2, **DRAGS)))
    assert found is not None
    assert found.after_s - 1.0 <= 15.0 <= found.until_s <= 17.5
    assert found.fall > 10.0
    assert found.to_json()["text"].startswith("the unit changed in the middle of this log, between")


def test_one_unit_has_not_changed():
    assert change_in(joined(log(1), log(2))) is None


def test_what_lasts_all_along_is_no_change():
    assert change_in(joined(log(1, **DRAGS), log(2, **DRAGS))) is None


def test_what_ends_again_is_no_change():
    first = joined(log(1), part_of(log(2, **DRAGS), (-math.inf, 6.0)))
    assert change_in(joined(first, log(3), at=21.0)) is None


def test_a_fault_of_the_first_part_is_not_taken_for_the_unit():
    late = log(1, actuation_delay=("delay", 0.06))
    assert change_in(joined(late, log(2))) is None


@pytest.fixture(scope="module")
def braked():
    """Diagnosis of a log in the middle of which a brake begins to drag."""
    return diagnose([joined(log(1), log(2, **DRAGS))], SYSTEM)


def test_the_cause_in_the_later_part_is_named(braked):
    assert braked.verdict in ("cause", "ambiguous")
    assert braked.causes[0].name == "coulomb"
    estimate = braked.causes[0].parameters["coulomb.torque"]
    assert estimate.low <= 0.1 <= estimate.high


def test_the_headline_says_since_when(braked):
    assert headline(braked).startswith("The unit changed in the middle of this log, between 1")
    assert ". Since then: the simulation lacks: coulomb" in headline(braked)
    assert braked.unexplained["signatures"][0]["kind"] == "changed_midway"


def test_the_report_is_of_the_later_part(braked, tmp_path):
    until = braked.unexplained["changed_midway"]["until_s"]
    assert (braked.gain.replayed.t0 >= until).all()
    assert "Since then: the simulation lacks" in braked.save(tmp_path / "report").read_text()


def test_since_when_is_said_only_where_the_part_before_was_asked():
    found = diagnose([joined(log(1), log(2, **DRAGS))], SYSTEM, time_limit=2.0)
    unasked = SEEN_BEFORE in found.left_out
    assert not (unasked and "Since then" in headline(found))
