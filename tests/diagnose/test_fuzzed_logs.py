"""Damaged logs end in one clear error or an honest diagnosis.

The suite reads and inspects 100 cases and diagnoses a few. DEEPKOCO_FUZZ_CASES=N diagnoses N cases as well;
`python -m experiments.studies.diagnosis.fuzz_logs --cases 1000` writes down what became of each.
"""

import os

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from experiments.studies.diagnosis.fuzz_logs import (
    FuzzCase,
    Verdicts,
    case_strategy,
    cases,
    main,
    read_case,
    run_case,
)
from experiments.studies.diagnosis.log_faults import FAULTS

pytest.importorskip("rosbags")
DIAGNOSED = int(os.environ.get("DEEPKOCO_FUZZ_CASES", "0"))
QUIET = list(HealthCheck)


@pytest.fixture(scope="module")
def verdicts():
    return Verdicts()


@settings(max_examples=100, deadline=None, database=None, derandomize=True, suppress_health_check=QUIET)
@given(case_strategy())
def test_reading_and_inspecting_never_ends_in_a_traceback(case):
    result, _, _ = read_case(case)
    assert result.wrong == "", result


@pytest.mark.parametrize("fault", sorted(FAULTS))
@pytest.mark.parametrize("form", ["csv", "mcap"])
def test_damaged_logs_are_refused_or_read_for_every_fault(fault, form):
    result, recording, _ = read_case(FuzzCase(0, form, (fault,), 3))
    assert result.wrong == "", result
    assert (recording is None) == (result.outcome == "refused")


@pytest.mark.study
@pytest.mark.parametrize(("fault", "seed"), [("NaN burst, filled", 1), ("lost rows", 1)])
def test_a_damaged_log_names_no_cause_that_the_clean_one_does_not_show(fault, seed, verdicts):
    result = run_case(FuzzCase(0, "csv", (fault,), seed), verdicts)
    assert result.wrong == "", result


@pytest.mark.study
@pytest.mark.parametrize(
    ("base", "form", "faults", "seed", "named"),
    [
        (1, "csv", ("command in other unit",), 1, "unit_slip"),
        # Both faults together are a factor of 10, which is no constant between units but near one (30 / pi).
        (0, "mcap", ("command in other unit", "command in other unit"), 0, "gain"),
    ],
)
def test_a_command_in_another_unit_is_named_as_such(base, form, faults, seed, named, verdicts):
    result = run_case(FuzzCase(base, form, faults, seed), verdicts)
    assert result.wrong == "", result
    assert result.names[0] == named


@pytest.mark.study
@pytest.mark.parametrize("case", [FuzzCase(0, "parquet", ("frozen channel",), 25261)])
def test_frozen_sensor_is_reported_and_names_no_cause(case, verdicts):
    result = run_case(case, verdicts)
    assert result.wrong == "", result
    assert '"theta" repeats one value from 2.66 to 6.2 s (355 samples)' in result.text


@pytest.mark.skipif(DIAGNOSED == 0, reason="DEEPKOCO_FUZZ_CASES is not set")
@settings(max_examples=max(DIAGNOSED, 1), deadline=None, phases=[Phase.generate], suppress_health_check=QUIET)
@given(case=case_strategy())
def test_diagnoses_of_damaged_logs_name_no_false_cause(case, verdicts):
    result = run_case(case, verdicts)
    assert result.wrong == "", result


def test_cases_are_different_and_follow_from_the_seed():
    drawn = cases(50, 1)
    assert drawn == cases(50, 1)
    assert len(set(drawn)) == 50


def test_results_are_never_overwritten(tmp_path, capsys):
    (tmp_path / "fuzzed_logs.csv").write_text("mine")
    assert main(["--cases", "1", "--out", str(tmp_path)]) == 2
    assert "fuzzed_logs.csv: exists" in capsys.readouterr().err
