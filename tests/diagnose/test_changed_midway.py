"""A unit that becomes another one in the middle of its log."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.diagnose.report.text import headline
from deepkoco.diagnose.residuals.residuals import dispersion
from deepkoco.diagnose.verdict.midway import changed_midway, clearest_changes
from deepkoco.excitation.record import record
from deepkoco.fit.data.windows import cut_windows, moving
from deepkoco.logs.part import seconds
from deepkoco.systems import make_system
from deepkoco.unit import make_unit
from tests.diagnose import two_units

WEIGHT = make_system("torque_pendulum").parameter("gravity_torque").value

ROUGH = {"coulomb": {"torque": 0.05}, "quadratic": {"drag": 0.01}}


@cache
def log(seed, seconds=10.0, rough=None, **changed):
    sensor, effects = {"rate_hz": 100.0}, {} if rough is None else {rough: ROUGH[rough]}
    unit = make_unit("torque_pendulum", effects=effects, parameters=changed, sensor=sensor, seed=seed)
    return record(unit, "steps", seconds, clock="simulated", seed=seed)


def joined(first, second):
    return two_units.joined(first, second, 10.0)


def windows_of(recording):
    system = make_system("torque_pendulum")
    windows = cut_windows([recording], system, 1.0)
    windows = windows.take(moving(windows))
    return baseline_from(system, windows), windows


def asked(recording):
    return changed_midway(*windows_of(recording))


def test_a_weight_that_changes_in_the_middle_is_seen_with_its_time_and_its_values():
    found = asked(joined(log(1), log(2, gravity_torque=0.7 * WEIGHT)))
    assert found is not None
    assert found.evidence(None).statistic == found.fall > 10.0
    assert found.after_s < 10.0 < found.until_s < found.after_s + 3.0
    assert found.evidence(None).text.startswith("The unit changed in the middle")
    assert f"gravity_torque from {WEIGHT:.2g} to 2.1" in found.evidence(None).text
    assert found.later.values["gravity_torque"] == pytest.approx(0.7 * WEIGHT, rel=0.01)


def test_the_parts_are_named_as_the_command_takes_them():
    found = asked(joined(log(1), log(2, gravity_torque=0.7 * WEIGHT)))
    said = found.evidence("logs/monday.csv").text
    assert f'deepkoco diagnose "logs/monday.csv#t={seconds(found.until_s)}"' in said
    assert f'--healthy "logs/monday.csv#t=,{seconds(found.after_s)}"' in said
    assert "#t=" not in found.evidence(None).text


def test_one_unit_in_two_motions_has_not_changed():
    assert asked(joined(log(1), log(2))) is None


def test_a_unit_that_differs_from_the_simulation_all_along_has_not_changed():
    assert asked(joined(log(1, gravity_torque=0.7 * WEIGHT), log(2, gravity_torque=0.7 * WEIGHT))) is None


def test_parts_that_are_not_explained_up_to_noise_may_have_changed():
    found = asked(joined(log(1, rough="coulomb"), log(2, rough="coulomb", gravity_torque=0.7 * WEIGHT)))
    assert found is not None
    assert found.evidence(None).text.startswith("The unit may have changed in the middle of this log")
    assert "though not down to the noise" in found.evidence(None).text


def test_parameters_that_only_imitate_what_is_missing_do_not_differ_clearly():
    # One unit in two motions: its quadratic drag, which the simulation lacks, looks like another viscous friction.
    given = [windows_of(log(seed, rough="quadratic")) for seed in (1, 2)]
    start, parts = given[0][0], [windows for _, windows in given]
    sides = [refit(start, part) for part in parts]
    deflations = [dispersion(side, part).deflation for side, part in zip(sides, parts, strict=True)]
    assert clearest_changes(start, sides, deflations) == ""


def test_few_windows_show_a_change_where_both_parts_are_explained_down_to_the_noise():
    start, windows = windows_of(joined(log(1), log(2, gravity_torque=0.7 * WEIGHT)))
    some = windows.take(np.array([0, 2, 4, 12, 14, 16]))
    assert changed_midway(start, some) is not None


def test_held_out_windows_of_one_unit_refute_a_change():
    # The parts differ, but what is held out is of the first unit alone: the later part does not foretell it.
    start, windows = windows_of(joined(log(1), log(2, gravity_torque=0.7 * WEIGHT)))
    other = windows_of(joined(log(1), log(3)))[1]
    assert changed_midway(start, windows, other.take(np.flatnonzero(other.t0 < 10.0))) is not None
    assert changed_midway(start, windows, other) is None


@pytest.fixture(scope="module")
def dropped():
    """Diagnosis of a log in the middle of which the weight falls."""
    return diagnose([joined(log(1), log(2, gravity_torque=0.7 * WEIGHT))], make_system("torque_pendulum"))


def test_the_model_is_that_of_the_unit_as_it_is_now(dropped):
    assert dropped.verdict == "unknown"
    assert dropped.model.parameter("gravity_torque").value == pytest.approx(0.7 * WEIGHT, rel=0.01)
    estimate = dropped.final["gravity_torque"]
    assert estimate.low <= 0.7 * WEIGHT <= estimate.high
    assert dropped.refit["gravity_torque"].value > 0.75 * WEIGHT  # of the whole log: neither unit


def test_the_gain_counts_windows_after_the_change_and_says_so(dropped):
    gain, until = dropped.gain, dropped.unexplained["changed_midway"]["until_s"]
    assert (gain.replayed.t0 >= until).all()
    assert gain.channels[0].extended < 0.2 * min(gain.channels[0].refit, gain.channels[0].baseline)
    assert f"of the unit from {seconds(until)} s on" in dropped.gain_note


def test_a_log_that_rests_beside_it_changes_nothing():
    rest = log(4)
    still = {n: replace(c, value=np.full(len(c), c.value[0])) for n, c in rest.channels.items()}
    moving_one = replace(joined(log(1), log(2, gravity_torque=0.7 * WEIGHT)), path=Path("a.csv"))
    both = [moving_one, replace(rest, channels=still, path=Path("b.csv"))]
    found = diagnose(both, make_system("torque_pendulum"))
    assert 'deepkoco diagnose "a.csv#t=' in found.unexplained["signatures"][0]["text"]


def test_headline_and_report_say_that_the_unit_changed(dropped, tmp_path):
    assert "the unit changed in the middle of this log, between" in headline(dropped)
    assert "family" not in dropped.unexplained
    page = dropped.save(tmp_path / "report").read_text()
    assert "simulation of the unit after its change" in page


def test_a_log_of_two_units_names_no_cause_that_lasts(dropped):
    assert dropped.names == ("unknown",)
    assert dropped.unexplained["signatures"][0]["kind"] == "changed_midway"
