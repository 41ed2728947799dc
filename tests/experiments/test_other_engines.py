"""The study of arms in other engines: cases by seed, units in MuJoCo, what counts as right; Bullet is not needed."""

import mujoco
import numpy as np
import pandas as pd
import pytest

from deepkoco.logs import read_logs
from deepkoco.systems import load_system
from experiments.studies.diagnosis import other_engines
from experiments.studies.diagnosis.other_engines import HIDDEN, ROBOTS, Case, draw_case, wanted, write_log
from experiments.studies.diagnosis.rows import go_on, read_rows
from experiments.studies.diagnosis.urdf_arms import ENGINES, holding, reach, urdf_of

VALUES = {f"{k}_{j}": v for j in ("shoulder", "elbow") for k, v in
          {"length": 0.3, "mass": 0.8, "damping": 0.1, "friction": 0.05}.items()}  # fmt: skip


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(other_engines, "SECONDS", 3.0)


def test_cases_follow_from_seed_and_number_and_hide_everything_in_every_engine():
    cases = [draw_case(3, k) for k in range(len(ENGINES) * len(HIDDEN))]
    assert cases == [draw_case(3, k) for k in range(len(cases))]
    assert {(c.engine, c.hidden) for c in cases} == {(e, h) for e in ENGINES for h in HIDDEN}
    for case in cases:
        far = {k for k in case.given if abs(case.unit[k] / case.given[k] - 1.0) > 0.2}
        assert far == ({f"friction_{case.joint}"} if case.hidden == "friction" else set())
        assert case.truth > 0.0 or case.hidden == "nothing"


def test_a_payload_is_a_point_mass_at_the_end_of_the_last_link():
    bare, loaded = (
        mujoco.MjModel.from_xml_string(urdf_of(("shoulder", "elbow"), VALUES, mass)) for mass in (0.0, 0.2)
    )
    data = [mujoco.MjData(m) for m in (bare, loaded)]
    mass = [np.zeros((2, 2)) for _ in data]
    for model, own, table in zip((bare, loaded), data, mass, strict=True):
        own.qpos[:] = (0.4, -0.9)
        mujoco.mj_forward(model, own)
        mujoco.mj_fullM(model, own, table)
    # The end is at 0.3 (cos, -sin)(0.4) + 0.3 (cos, -sin)(-0.5) in x and z, y being the axis of both joints.
    first, second = (0.3 * np.array([-np.sin(a), -np.cos(a)]) for a in (0.4, -0.5))
    moves = np.stack([first + second, second])
    np.testing.assert_allclose(mass[1] - mass[0], 0.2 * moves @ moves.T, atol=1e-9)
    pull = data[1].qfrc_bias - data[0].qfrc_bias
    np.testing.assert_allclose(pull, 0.2 * 9.81 * moves[:, 1], atol=1e-9)


def test_sizes_of_an_arm_tell_what_holds_it_and_what_it_moves():
    # Two links of 0.8 kg and 0.3 m, centres at 0.45 of them: 9.81 * 0.8 * (0.135 + 0.435) and 9.81 * 0.8 * 0.135.
    np.testing.assert_allclose(holding(("shoulder", "elbow"), VALUES), [4.47336, 1.05948])
    assert holding(("yaw",), {"length_yaw": 1.0, "mass_yaw": 1.0})[0] == 0.0
    np.testing.assert_allclose(
        reach(("shoulder", "elbow"), VALUES), [0.8 * (0.18**2 + 0.48**2), 0.8 * 0.18**2]
    )


def of(hidden, engine="mujoco"):
    return next(c for k in range(200) if (c := draw_case(0, k)).hidden == hidden and c.engine == engine)


@pytest.mark.parametrize("hidden", HIDDEN)
def test_a_log_needs_no_sidecar(tmp_path, hidden):
    case = of(hidden)
    log, urdf = write_log(case, tmp_path)
    system = load_system(urdf)
    (recording,) = read_logs([log], system)
    joints = ROBOTS[case.robot]
    assert set(recording.channels) == {n for j in joints for n in (j, f"q_{j}", f"dq_{j}")}
    for name in (n[8:-1] for n in wanted(case) if n.startswith("changed(")):
        system.parameter(name)
    moved = pd.read_csv(log).filter(like="position")
    assert (np.ptp(moved, axis=0) > 0.2).all()
    assert (np.abs(moved) < 3.0).all(axis=None)


def test_a_delay_is_one_of_the_commands(tmp_path):
    case = of("delay")
    logs = []
    for truth in (case.truth, 0.0):
        own = Case(**{**case.__dict__, "truth": truth})
        logs.append(pd.read_csv(write_log(own, tmp_path)[0]))
    late = round(case.truth / case.period)
    assert late > 0
    effort = [log.filter(like="effort").to_numpy() for log in logs]
    np.testing.assert_array_equal(effort[0][0], effort[1][0])
    # The first command acts until the second one does, so both loops send different ones from then on.
    assert not np.allclose(effort[0][late + 2], effort[1][late + 2], atol=1e-9)


def test_an_engine_that_is_not_here_is_refused(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(other_engines, "has_engine", lambda name: name != "bullet")
    with pytest.raises(SystemExit):
        other_engines.main(["--out", str(tmp_path), "--engines", "bullet"])
    assert "pip install pybullet" in capsys.readouterr().err


def test_a_killed_study_goes_on_where_it_was(tmp_path):
    asked, table = [], tmp_path / "rows.csv"

    def row(index):
        asked.append(index)
        return {"number": index, "square": index**2}

    go_on(table, ("number", "square"), 2, row)
    go_on(table, ("number", "square"), 4, row)
    assert asked == [0, 1, 2, 3]
    assert read_rows(table) == [{"number": str(k), "square": str(k**2)} for k in range(4)]
