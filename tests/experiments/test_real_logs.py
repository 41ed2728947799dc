"""The study on real logs, on logs of a unit laid out in the same way."""

import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepkoco.excitation.record import record
from deepkoco.unit import make_unit
from experiments.studies.diagnosis.real_log_studies import STUDIES, Piece, parse_piece, split, study_of
from experiments.studies.diagnosis.real_logs import main

REAL = os.environ.get("DEEPKOCO_REAL_LOGS")
NAMES = ("energy_shaping", "sac", "ddp_pd", "direct_collocation_pd")


def write_logs(folder, names=NAMES):
    """Four logs of a torque pendulum with dry friction, in the columns of the real ones."""
    folder.mkdir()
    for seed, (name, excitation) in enumerate(zip(names, ("steps", "chirp", "prbs", "steps"), strict=True)):
        spec = make_unit("torque_pendulum", effects={"coulomb": {"torque": 0.15}}, seed=seed)
        log = record(spec, excitation, 5.0, control_rate=100.0, clock="simulated", seed=seed)
        theta, omega, torque = (log.channels[n] for n in ("theta", "omega", "torque"))
        # The study takes a torque for a sample in the middle of its time; a command begins at its stamp.
        columns = {
            "t": theta.t,
            "pos": theta.value,
            "vel": omega.value,
            "tau_meas": torque.hold(theta.t + 0.001),
        }
        pd.DataFrame(columns).to_csv(folder / f"{name}.csv", index=False)


@pytest.mark.study
def test_friction_is_named_and_pays(tmp_path):
    write_logs(tmp_path / "mine", ("one", "three", "two", "zero"))  # another folder with the same columns
    printed = []
    command = ["--data", str(tmp_path), "--log", "mine", "--json", "--answers", str(tmp_path / "kept")]
    assert main(command, printed.append) == 0
    result = json.loads(printed[0])
    assert main(command, printed.append) == 0
    assert printed[1] == printed[0], "what is answered is not asked again"
    assert [f.name for f in (tmp_path / "kept").iterdir()] == ["mine_held_out_logs.json"]
    assert list(result)[:7] == [
        "verdict",
        "first",
        "class",
        "rmse_baseline",
        "rmse_refit",
        "rmse_extended",
        "seconds",
    ]
    assert result["rmse_extended"] < 0.5 * result["rmse_refit"]
    assert result["system"] == "torque_pendulum"
    assert list(result["questions"]) == ["held-out logs"]
    assert result["channels"]["theta"][2] == result["rmse_extended"]
    assert np.isfinite(result["seconds"])


def test_missing_data_is_one_line(tmp_path, capsys):
    assert main(["--data", str(tmp_path), "--log", "dfki_pendulum"]) == 2
    assert "energy_shaping.csv: no such file" in capsys.readouterr().err


def frame_of(study, seconds=3.0):
    """Columns of a log of this kind, all moving."""
    t = np.arange(0.0, seconds, 0.01)
    waves = {c: np.sin((k + 2) * t) for k, (c, _) in enumerate(study.columns.values())}
    return pd.DataFrame({study.time: t, **waves})


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_a_folder_is_taken_for_the_kind_that_has_its_columns(name, tmp_path):
    study = STUDIES[name]
    frame = frame_of(study)
    for speed in (c for c in study.columns if c.startswith(("speed", "omega"))):
        angle = study.columns[speed.replace("speed", "angle").replace("omega", "theta")][0]
        frame[study.columns[speed][0]] = np.gradient(frame[angle], frame[study.time])
    frame.to_csv(tmp_path / "a.csv", index=False)
    found, questions = study_of(tmp_path)
    assert found is study
    assert questions["held-out logs"].train == (Piece("a.csv"),)
    log = study.read(tmp_path, Piece("a.csv", 0.5, 2.0, {"payload.mass": 0.2}))
    assert set(log.channels) == set(study.columns)
    assert log.meta["known"] == {"payload.mass": 0.2}
    for command, (column, _) in study.columns.items():
        if command in study.measured:
            series = log.channels[command]
            assert np.allclose(series.value, np.interp(series.t + 0.005, frame[study.time], frame[column]))


def test_one_of_four_logs_is_kept_for_tests():
    pieces = [Piece(f"{k}.csv") for k in range(9)]
    assert [p.file for p in split(pieces).test] == ["3.csv", "7.csv"]
    assert len(split(pieces).train) == 7
    assert split(pieces[:2]).test == (Piece("1.csv"),)
    assert split(pieces[:1]).test == ()


def test_stretches_are_given_as_file_and_times():
    assert parse_piece("a.csv") == Piece("a.csv")
    assert parse_piece("a.csv:0.5:4") == Piece("a.csv", 0.5, 4.0)
    for wrong in ("a.csv:4:1", "a.csv:1", "a.csv:x:y"):
        with pytest.raises(ValueError, match=r"a\.csv|could not convert"):
            parse_piece(wrong)


@pytest.mark.parametrize(
    ("folder", "header", "message"),
    [
        ("rex_real_delays", "t,a", "experiments.studies.graph.real_delays studies them"),
        ("odd", "t,a,b", "no known kind of log"),
        ("gone", None, "no such folder; known ones are"),
    ],
)
def test_a_folder_that_cannot_be_studied_is_one_line(folder, header, message, tmp_path, capsys):
    if header:
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.csv").write_text(header + "\n")
    assert main(["--data", str(tmp_path), "--log", folder]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.skipif(
    REAL is None, reason="real logs are not in the repository; DEEPKOCO_REAL_LOGS names their folder"
)
@pytest.mark.parametrize("name", sorted(STUDIES))
def test_every_stretch_of_the_real_logs_can_be_read(name):
    study = STUDIES[name]
    for question in study.questions.values():
        for piece in (*question.train, *question.test, *question.healthy):
            log = study.read(Path(str(REAL)) / name, piece)
            assert log.stop - log.start > 2.0 * study.window
