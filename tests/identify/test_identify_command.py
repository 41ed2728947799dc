"""`deepkoco identify` from a log on disk to a folder of results."""

import json

import pandas as pd
import pytest

from deepkoco.cli import main
from deepkoco.graph.recording import write_log
from deepkoco.systems import load_model
from tests.identify.identify_logs import DELAY, MASS, pendulum_log


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("logs") / "steps.csv", pendulum_log(5.0))


def test_from_a_log_to_a_folder(log, tmp_path, capsys):
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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--parameters", "masss"], "did you mean mass"),
        (["--method", "newton"], "is none of lm, cma"),
        (["--bounds", "mass=1"], "expected NAME=NUMBER:NUMBER"),
        (["--prior", "mass=1:0"], "must be positive"),
        (["--population", "20"], "belongs to --method cma"),
        (["--system", "rocket"], 'unknown system "rocket"'),
        (["--window", "0"], "between 0.05 and 60 s"),
    ],
)
def test_mistakes_are_one_line(log, tmp_path, capsys, arguments, message):
    assert main(["identify", str(log), "--out", str(tmp_path / "none"), *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "none").exists()
