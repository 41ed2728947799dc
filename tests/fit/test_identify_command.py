"""`deepkoco identify`: from a log on disk to a folder of results."""

import json
import shutil

import pandas as pd
import pytest

from deepkoco.cli.command_line import main
from deepkoco.excitation.record import record
from deepkoco.graph.delay import make_delay
from deepkoco.logs.recording import write_log
from deepkoco.systems import load_model
from deepkoco.unit import make_unit
from tests.fit.identify_logs import DELAY, MASS, TRUE, arm_log, pendulum_log, rod_log


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("logs") / "steps.csv", pendulum_log(5.0))


def test_identify_writes_a_folder_from_a_log(log, tmp_path, capsys):
    out = tmp_path / "found"
    arguments = [str(log), "--parameters", "mass", "--delays", "--bounds", "mass=0.03:0.1", "--out", str(out)]
    assert main(["identify", *arguments]) == 0
    said = capsys.readouterr().out
    assert "mass" in said
    assert "kg" in said
    assert "converged" in said
    result = json.loads((out / "identify.json").read_text())
    mass = result["parameters"]["mass"]
    assert mass["value"] == pytest.approx(MASS, rel=0.02)
    assert mass["low"] < mass["value"] < mass["high"]
    assert mass["bounds"] == [0.03, 0.1]
    model = load_model(out / "model.yaml")
    assert model.parameter("mass").value == mass["value"]
    assert model.parameter("actuation_delay.delay").value == pytest.approx(DELAY, abs=1e-3)
    for name in ("replay", "intervals", "correlation", "convergence"):
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert len(pd.read_csv(out / f"{name}.csv")) > 0
    assert main(["identify", *arguments]) == 2
    assert "exists" in capsys.readouterr().err


def test_identify_says_what_was_assumed_of_its_logs(log, tmp_path, capsys):
    given = pd.read_csv(log)
    given.loc[[40, 41], given.columns[-1]] = None
    given.to_csv(tmp_path / "steps.csv", index=False)
    shutil.copy(log.with_suffix(".yaml"), tmp_path / "steps.yaml")
    out = tmp_path / "found"
    arguments = [str(tmp_path / "steps.csv"), "--parameters", "mass", "--fill", "drop", "--out", str(out)]
    assert main(["identify", *arguments]) == 0
    assert "assumed: " in capsys.readouterr().out
    assert "missing samples left out" in json.loads((out / "identify.json").read_text())["warnings"][0]


@pytest.mark.study
def test_identify_writes_hidden_delays(tmp_path, capsys):
    effects = {"actuation_delay": {"delay": {"mean": 0.02, "sd": 0.004}}}
    unit = make_unit("rod_pendulum", effects=effects, sensor={"rate_hz": 200}, seed=4)
    log = write_log(tmp_path / "prbs.csv", record(unit, "prbs", 15.0, clock="simulated", seed=4))
    out = tmp_path / "found"
    arguments = ["--parameters", "mass", "--hidden-delays", "--out", str(out)]
    assert main(["identify", str(log), *arguments]) == 0
    assert "message by message: mean" in capsys.readouterr().out
    found = json.loads((out / "identify.json").read_text())["hidden_delays"]
    assert found["mean_s"] == pytest.approx(0.02, abs=0.002)
    assert found["spread_interval_s"][0] < 0.004 < found["spread_interval_s"][1]
    assert make_delay(found["law"]).mean == pytest.approx(found["mean_s"], rel=0.01)
    table = pd.read_csv(out / "delays.csv")
    assert len(table) == found["messages"]
    assert (out / "delays.png").read_bytes().startswith(b"\x89PNG")


def test_identify_fits_a_system_of_two_joints(tmp_path, capsys):
    log = write_log(tmp_path / "arm.csv", arm_log(0))
    arguments = ["--parameters", "mass_2", "--start", "viscous_1=1.8", "viscous_2=0.6", "--json"]
    assert main(["identify", str(log), *arguments, "--out", str(tmp_path / "found")]) == 0
    found = json.loads(capsys.readouterr().out)["parameters"]["mass_2"]
    assert found["value"] == pytest.approx(TRUE["mass_2"], rel=0.02)


def test_identify_varies_friction_between_logs(tmp_path, capsys):
    logs = [
        str(write_log(tmp_path / f"{k}.csv", rod_log(5.0, seed=k, viscous=v)))
        for k, v in enumerate((0.01, 0.05), start=1)
    ]
    arguments = ["identify", *logs, "--system", "rod_pendulum", "--parameters", "mass", "viscous"]
    assert main([*arguments, "--varies", "viscous=0.03", "--out", str(tmp_path / "found")]) == 0
    assert "viscous of log 2" in capsys.readouterr().out
    own = json.loads((tmp_path / "found" / "identify.json").read_text())["of_logs"]
    assert [e["value"] for e in own.values()] == pytest.approx([0.01, 0.05], abs=2e-3)
    assert main([*arguments, "--varies", "viscous", "--out", str(tmp_path / "none")]) == 2
    assert "--varies viscous: expected NAME=NUMBER" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--parameters", "masss"], "did you mean mass"),
        (["--method", "newton"], "is none of lm, cma"),
        (["--bounds", "mass=1"], "expected NAME=NUMBER:NUMBER"),
        (["--prior", "mass=1:0"], "must be positive"),
        (["--population", "20"], "needs --method cma"),
        (["--system", "rocket"], 'unknown system "rocket"'),
        (["--hidden-delays", "0"], "1 to 8 components"),
        (["--window", "0"], "between 0.05 and 60 s"),
    ],
)
def test_identify_reports_a_mistake_in_one_line(log, tmp_path, capsys, arguments, message):
    assert main(["identify", str(log), "--out", str(tmp_path / "none"), *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "none").exists()
