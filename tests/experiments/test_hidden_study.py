"""The study of hidden effects: cases, resuming, measures worked out by hand."""

import json
import math
from dataclasses import replace

import pytest

from experiments.studies.diagnosis.hidden.cases import make_case, record_case
from experiments.studies.diagnosis.hidden.measures import measures
from experiments.studies.diagnosis.hidden_effects import COLUMNS, ResumeError, read_rows
from tests.oracle.doses import scaled, strength, unexplained
from tests.oracle.unit import HiddenUnit, hidden_log


def row(**given):
    base = dict.fromkeys(COLUMNS, "")
    base |= {"kind": "single", "hidden": "gain", "ES": "1.0", "verdict": "cause", "classes": "[]"}
    return base | {"parameters": "[]", "chi2_before": "1.0", "cpu_s": "1.0"} | given


def test_a_case_does_not_depend_on_what_was_drawn_before():
    first = [make_case(i, 101, "two_link_arm", "clean") for i in range(40)]
    assert make_case(17, 101, "two_link_arm", "clean") == first[17]
    assert {c.kind for c in first} == {"control", "single", "pair", "outside"}
    assert all(len(c.names) == {"control": 0, "pair": 2}.get(c.kind, 1) for c in first)
    assert all(
        c.excitation == "bang-bang" for c in [make_case(i, 1, "pendulum", "bang-bang") for i in range(9)]
    )


def test_measures_by_hand():
    estimate = {"name": "gain.factor", "true": 0.8, "value": 0.81, "low": 0.79, "high": 0.83}
    rows = [
        row(kind="control", hidden="", ES="", verdict="nothing"),
        row(kind="control", hidden="", ES="", verdict="cause", classes='[["lag"]]'),
        row(
            classes='[["gain", "payload"]]', parameters=json.dumps([estimate]), gain="0.5", oracle_gain="0.5"
        ),
        row(classes='[["payload", "gain"]]', against_given="1.05"),
        row(classes='[["lag"]]'),
        row(ES="0.15", verdict="nothing"),
        row(kind="pair", hidden="gain + lag", classes='[["lag"], ["payload", "gain"]]'),
        row(
            kind="outside", hidden="turbulence", verdict="unknown", classes='[["unknown"]]', chi2_before="2.0"
        ),
    ]
    found = measures(rows)
    assert (found["false_alarms"]["count"], found["false_alarms"]["of"]) == (1, 2)
    assert (found["top_1_in_class"]["count"], found["top_1_in_class"]["of"]) == (2, 3)
    assert found["exact_top_1"]["count"] == 1
    assert found["set_size"] == {"value": pytest.approx(5 / 3, abs=1e-3), "of": 3}
    assert (found["detected_ES_0.1_to_0.2"]["count"], found["detected_ES_0.1_to_0.2"]["of"]) == (0, 1)
    assert found["pairs_both_named"]["share"] == 1.0
    assert found["outside_called_unknown"]["share"] == 1.0
    # 0.01 off of an effect of 0.2.
    assert found["parameter_error_median"] == {"value": pytest.approx(0.05), "of": 1}
    assert found["interval_coverage"]["share"] == 1.0
    assert found["worse_than_given_by_2_percent"]["count"] == 1


def test_a_row_that_a_kill_cut_off_is_run_again(tmp_path):
    path = tmp_path / "rows.csv"
    whole = ",".join(COLUMNS) + "\n" + "0,101,pendulum,clean" + "," * (len(COLUMNS) - 4) + "\n"
    path.write_text(whole + "1,102,pendu")
    assert set(read_rows(path, "pendulum", "clean", 101)) == {0}
    assert path.read_text() == whole
    with pytest.raises(ResumeError, match="seed 101"):
        read_rows(path, "pendulum", "clean", 500)
    with pytest.raises(ResumeError, match="another study"):
        read_rows(path, "two_link_arm", "clean", 101)


def test_an_effect_that_stops_the_machine_is_beyond_every_strength():
    """Its dose has to shrink; there is nothing in such a log that a baseline could be fitted to."""
    still = hidden_log("rod_pendulum", {"gain": {"factor": 0.0}}, "bang-bang", 1, 6.0, noisy=False)
    assert unexplained(still, "rod_pendulum") == (math.inf, 1)
    assert strength("rod_pendulum", {"gain": {"factor": 0.0}}, "bang-bang", 1, 6.0, 1.0) == math.inf


@pytest.mark.study
def test_a_push_on_a_joint_at_rest_does_not_grow_out_of_all_bounds():
    """Windows in which a joint rests say nothing, and no dose of what acts there alone shows."""

    def push(dose):
        return {"event": {"torque": 0.5 * dose, "start": 7.3, "duration": 0.2}} if dose else {}

    hidden, found = scaled(push, "rod_pendulum", "closed-loop", 2738, 30.0, 1.6)
    assert hidden == push(1.0)
    assert found < 0.01


@pytest.mark.parametrize("effect", ["lag", "low_pass"])
def test_a_lag_below_the_step_does_as_little_as_it_should(effect):
    logs = [
        hidden_log("rod_pendulum", hidden, "bang-bang", 1, 3.0, noisy=False)
        for hidden in ({}, {effect: {"time_constant": 2e-4}}, {effect: {"time_constant": 2e-3}})
    ]
    plain, fast, slow = (log.channels["theta"].value for log in logs)
    assert abs(fast - plain).max() < 2e-3
    # To first order a lag does what its time constant says.
    assert abs(fast - plain).max() == pytest.approx(0.1 * abs(slow - plain).max(), rel=0.05)


def test_in_runs_every_log_has_parameters_of_its_own_and_healthy_ones_the_floor_alone():
    case = make_case(0, 3800, "rod_pendulum", "runs")
    found = record_case(replace(case, kind="control", names=()), "rod_pendulum", "runs", 4.0)
    assert len(found.healthy) == 3
    units = [HiddenUnit("rod_pendulum", {}, case.seed, drawn, varies=0.02) for drawn in (None, 1, 2)]
    lengths = [unit.parameters["length"] for unit in units]
    assert len(set(lengths)) == 3
    assert max(abs(x / lengths[0] - 1.0) for x in lengths) < 0.2
    # Where nothing varies, takes differ in noise and commands alone.
    same = [HiddenUnit("rod_pendulum", {}, case.seed, drawn).parameters for drawn in (None, 1)]
    assert same[0] == same[1]
