"""Sheets of the study of data sheets: what they state, and what a row of it says."""

import numpy as np
import pytest

from experiments.studies.diagnosis import data_sheets
from experiments.studies.diagnosis.data_sheets import WRONG_BY, recording_of, sheet_of
from tests.oracle.mujoco_robots import pendulum
from tests.oracle.mujoco_unit import record

SHARE = 0.02


@pytest.fixture(scope="module")
def robot():
    return pendulum(np.random.default_rng(1), "motor")


def test_a_sheet_states_every_value_to_the_same_share(robot, tmp_path):
    system = sheet_of(robot, SHARE, "", tmp_path)
    assert not any(p.guessed for p in system.parameters)
    stated = [p for p in system.parameters if p.value]
    assert [p.prior_sd for p in stated] == pytest.approx([SHARE * abs(p.value) for p in stated])


def test_one_stated_value_is_wrong_by_so_many_deviations(robot, tmp_path):
    right, wrong = tmp_path / "right", tmp_path / "wrong"
    right.mkdir()
    wrong.mkdir()
    own = {p.name: p.value for p in sheet_of(robot, SHARE, "", right).parameters}
    told = {p.name: p.value for p in sheet_of(robot, SHARE, "gain(motor)", wrong).parameters}
    assert told.pop("gain(motor)") == pytest.approx(own.pop("gain(motor)") * (1.0 + WRONG_BY * SHARE))
    assert told == pytest.approx(own)


def test_masses_and_frictions_of_a_unit_are_1_to_3_percent_off():
    rng = np.random.default_rng(0)
    away = np.array([abs(data_sheets._off(rng) - 1.0) for _ in range(100)])
    assert away.min() >= 0.01
    assert away.max() <= 0.03


def test_a_recording_has_the_commands_and_readings_of_the_log(robot):
    log = record(robot, None, 3, 1.0, off=data_sheets._off)
    own = recording_of(log)
    kinds = {name: series.kind for name, series in own.channels.items()}
    assert kinds["motor"] == "command"
    assert kinds["q_hinge"] == "measurement"
    assert np.array_equal(own.channels["q_hinge"].value, log.readings[:, 0])
