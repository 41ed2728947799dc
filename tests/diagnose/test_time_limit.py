"""A diagnosis with a time limit ends with the best answer so far and says what is missing."""

import json

import pytest

from deepkoco.cli.command_line import main
from deepkoco.diagnose import diagnose
from deepkoco.diagnose.report.text import lead
from deepkoco.diagnose.time_limit import TimeLimit, TimeLimitError
from tests.oracle.unit import hidden_log

CAUSES = ("coulomb", "viscous", "gain", "lost_commands")


class Clock:
    """A clock that is set by hand [s]."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture(scope="module")
def log():
    return hidden_log("rod_pendulum", {"coulomb": {"torque": 0.1}}, "steps", 3, 10.0)


@pytest.fixture(scope="module")
def full(log):
    return diagnose([log], "rod_pendulum", only=CAUSES)


def test_steps_are_allowed_until_the_time_is_over():
    clock = Clock()
    limit = TimeLimit(5.0, clock)
    clock.now = 104.9
    assert limit.allows("a further cause")
    assert limit.left_out == []
    clock.now = 105.0
    assert not limit.allows("a further cause")
    assert not limit.allows("lost commands")
    assert not limit.allows("a further cause")
    assert limit.left_out == ["a further cause", "lost commands"]


def test_without_a_limit_every_step_is_allowed_at_any_time():
    clock = Clock()
    limit = TimeLimit(None, clock)
    clock.now = 1e12
    assert limit.allows("lost commands")
    assert limit.left_out == []


def test_a_log_that_does_not_suffice_names_its_limit_too():
    short = hidden_log("rod_pendulum", {}, "steps", 3, 2.0)
    found = diagnose([short], "rod_pendulum", time_limit=5.0, detection=50.0)
    assert found.verdict == "insufficient"
    assert found.to_json()["time_limit"] == {"seconds": 5.0, "left_out": []}
    assert found.detection == 50.0


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_a_limit_that_is_not_positive_is_refused(seconds):
    with pytest.raises(TimeLimitError, match="give a positive number of seconds"):
        TimeLimit(seconds)


def test_a_diagnosis_whose_time_is_over_gives_its_best_answer_and_lists_what_is_missing(log, full):
    cut = diagnose([log], "rod_pendulum", only=CAUSES, time_limit=1e-9)
    assert full.left_out == ()
    assert "time_limit" not in full.to_json()
    assert cut.names == full.names == ("coulomb",)
    assert "a further cause together with coulomb" in cut.left_out
    assert cut.to_json()["time_limit"] == {"seconds": 1e-9, "left_out": list(cut.left_out)}
    said = "The time limit of 1e-09 s ended this diagnosis early"
    assert said in lead(cut)
    assert f"Not checked: {'; '.join(cut.left_out)}." in lead(cut)
    assert said not in lead(full)


@pytest.mark.study
def test_a_limit_that_is_not_reached_changes_nothing_but_its_own_key(log, full):
    slow = diagnose([log], "rod_pendulum", only=CAUSES, time_limit=1e6).to_json()
    assert slow.pop("time_limit") == {"seconds": 1e6, "left_out": []}
    free = full.to_json()
    for report in (free, slow):
        report.pop("seconds")
    assert json.dumps(slow) == json.dumps(free)


def test_the_command_refuses_a_limit_that_is_not_positive(tmp_path, capsys):
    path = tmp_path / "log.csv"
    path.write_text("t\n0.0\n")
    assert main(["diagnose", str(path), "--system", "rod_pendulum", "--time-limit", "0"]) == 2
    assert "--time-limit 0: give a positive number of seconds" in capsys.readouterr().err
