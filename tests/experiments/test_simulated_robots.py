"""The study of simulated robots: cases by seed, logs that a user could have written, and what counts as right."""

import numpy as np
import pandas as pd
import pytest

from deepkoco.logs import read_logs
from deepkoco.systems import load_system
from experiments.studies.diagnosis import simulated_robots
from experiments.studies.diagnosis.simulated_robots import HIDDEN, ROBOTS, draw_case, wanted, write_log


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(simulated_robots, "SECONDS", 3.0)


def test_cases_follow_from_seed_and_number_and_hide_everything_in_every_robot():
    cases = [draw_case(3, k) for k in range(len(ROBOTS) * len(HIDDEN))]
    assert cases == [draw_case(3, k) for k in range(len(cases))]
    assert {(c.robot, c.hidden) for c in cases} == {(r, h) for r in ROBOTS for h in HIDDEN}
    for case in cases:
        far = {k for k in case.given if abs(case.unit[k] / case.given[k] - 1.0) > 0.15}
        assert len(far) == (case.hidden in ("friction", "damping", "drive"))


@pytest.mark.parametrize("index", range(len(ROBOTS)))
def test_a_log_needs_no_sidecar(tmp_path, index):
    case = draw_case(0, index)
    log, xml = write_log(case, tmp_path)
    system = load_system(xml)
    (recording,) = read_logs([log], system)
    positions = {f"q_{joint}" for joint in ROBOTS[case.robot].joints}
    assert set(recording.channels) == positions | {c.name for c in system.commands}
    names = {p.name for p in system.parameters}
    for hidden in HIDDEN[1:4]:
        other = next(
            c for k in range(40) if (c := draw_case(0, k)).robot == case.robot and c.hidden == hidden
        )
        assert {n[8:-1] for n in wanted(other) if n.startswith("changed(")} & names


def test_a_delay_is_one_of_the_commands(tmp_path):
    case = next(c for k in range(40) if (c := draw_case(1, k)).hidden == "delay" and c.robot == "head")
    late, prompt = tmp_path / "late", tmp_path / "prompt"
    for folder in (late, prompt):
        folder.mkdir()
    silent = {**case.__dict__, "noise": {"rad": 0.0, "m": 0.0}}
    a, b = (
        pd.read_csv(write_log(simulated_robots.Case(**{**silent, "truth": truth}), folder)[0])
        for folder, truth in ((late, 0.1), (prompt, 0.0))
    )
    np.testing.assert_array_equal(a.filter(like="cmd"), b.filter(like="cmd"))
    place = b["pan_pos_rad"].to_numpy()
    # Ten samples late, once the start, in which the first command holds, has faded.
    error = np.abs(a["pan_pos_rad"].to_numpy()[110:] - place[100:-10]).max()
    assert error < 0.1 * np.abs(place[110:] - place[100:-10]).max()
