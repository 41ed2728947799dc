"""Results, files and errors of a whole diagnosis."""

import io
import json
import sys
import time
from contextlib import redirect_stdout
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from deepkoco.cli.command_line import main
from deepkoco.diagnose import FolderExistsError, diagnose, write_report
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.diagnosis import Estimate, Moved
from deepkoco.diagnose.report.text import headline, lead, terminal_table
from deepkoco.fit.compiling import COMPILING
from deepkoco.logs.recording import Series, write_log
from deepkoco.systems import load_model, make_system
from experiments.studies.diagnosis.hidden.recorded import unit_log

HIDDEN = {"coulomb": {"torque": 0.15}}
KEYS = {
    "schema",
    "verdict",
    "causes",
    "candidates",
    "gain",
    "fit",
    "localisation",
    "excitation_advice",
    "data",
    "seed",
    "versions",
    "seconds",
}


@pytest.fixture(scope="module")
def log():
    return unit_log("rod_pendulum", HIDDEN, "steps", 71, 20.0)


@pytest.fixture(scope="module")
def diagnosis(log):
    """A diagnosis among four causes, for what does not depend on the catalogue."""
    return diagnose([log], "rod_pendulum", seed=5, only=["coulomb", "viscous", "gain", "lag"])


@pytest.fixture(scope="module")
def whole(log):
    return diagnose([log], "rod_pendulum", seed=5)


class Commanded(NamedTuple):
    """A diagnosis by the command line: exit status, what it prints, and its folder."""

    status: int
    printed: str
    folder: Path


@pytest.fixture(scope="module")
def commanded(log, tmp_path_factory):
    folder = tmp_path_factory.mktemp("reports")
    path = write_log(folder / "log.csv", log)
    out = folder / "report"
    with redirect_stdout(io.StringIO()) as printed:
        status = main(
            ["diagnose", str(path), "--system", "rod_pendulum", "--out", str(out), "--json", "--seed", "5"]
        )
    return Commanded(status, printed.getvalue(), out)


@pytest.fixture(scope="module")
def report(commanded):
    return commanded.folder


def test_report_json_has_the_keys_of_the_contract(report):
    content = json.loads((report / "report.json").read_text())
    assert set(content) >= KEYS
    assert content["schema"] == 1
    assert content["verdict"] == "cause"
    first = content["causes"][0]
    assert {"name", "class", "delta_bic", "probability", "parameters", "evidence"} <= set(first)
    assert first["name"] == "coulomb"
    torque = first["parameters"]["coulomb.torque"]
    assert torque["low"] <= 0.15 <= torque["high"]
    assert torque["unit"] == "N m"
    assert {"metric", "horizon_s", "channels", "reduction_vs_refit", "low", "high", "windows"} <= set(
        content["gain"]
    )
    assert "No fit uses these windows" in content["gain"]["note"]
    assert "optimistic" in content["gain"]["note"]
    assert {"baseline", "refit", "extended", "unit"} <= set(content["gain"]["channels"]["theta"])
    known = catalogue(make_system("rod_pendulum"))
    tried = {c["name"] for c in content["candidates"]}
    fitted = {name for name, cause in known.items() if cause.free}
    # An addition to the viscous friction is a cause of its own already.
    fitted.remove("changed(viscous)")
    assert fitted <= tried
    # Slips of units are tried as well where the refit is far from its prior.
    assert {known[name].family for name in tried - fitted} <= {"unit"}


def test_gain_is_large_and_inside_its_interval(diagnosis):
    gain = diagnosis.gain
    assert gain.low <= gain.reduction <= gain.high
    assert gain.low > 0.3
    channel = gain.channels[0]
    assert channel.extended < channel.refit < channel.baseline


def test_every_picture_has_its_table_and_the_page_needs_no_other_file(report):
    pictures = sorted(p.stem for p in report.glob("*.png"))
    assert pictures == [
        "before_after",
        "candidates",
        "error_by_horizon",
        "error_map",
        "found_parameters",
        "friction_curve",
        "missing_torque",
        "parameters",
        "probabilities",
        "replay",
    ]
    assert all((report / f"{name}.csv").stat().st_size > 50 for name in pictures)
    page = (report / "report.html").read_text()
    # Each for a wide window and for a phone.
    assert page.count("<svg viewBox=") == 2 * len(pictures)
    assert "http" not in page
    assert "The simulation lacks: coulomb" in page


def test_friction_band_contains_the_hidden_friction(report):
    curve = pd.read_csv(report / "friction_curve.csv")
    fast = curve[curve.speed > 1.0]
    # Coulomb friction of 0.15 N m and little else, drawn within its band.
    assert np.allclose(fast.extended, 0.15, atol=0.02)
    assert (fast.extended_low <= fast.extended).all()
    assert (fast.extended_high >= fast.extended).all()
    assert np.allclose(curve.extended + curve.extended.to_numpy()[::-1], 0.0, atol=1e-9)


def test_model_is_a_system_and_diagnosing_from_it_finds_nothing(report):
    system = load_model(report / "model.yaml")
    assert system.parameter("coulomb.torque").value == pytest.approx(0.15, rel=0.05)
    second = unit_log("rod_pendulum", HIDDEN, "chirp", 71, 20.0)
    assert diagnose([second], system).verdict == "nothing"


@pytest.mark.study
def test_diagnose_with_the_same_seed_gives_the_same_report_with_or_without_progress(log, whole):
    told = []
    again = diagnose([log], "rod_pendulum", seed=5, progress=told.append)
    first, second = (json.dumps(replace(d, seconds=0.0).to_json()) for d in (whole, again))
    assert first == second
    steps = [step for step in told if step != COMPILING]
    assert steps[0] == "asking which simulator the logs are of"
    assert steps[1:3] == ["refit of the simulation as given", "fitting every cause"]
    assert told[-1] == "lost commands together with coulomb"


def test_write_report_refuses_an_existing_folder(diagnosis, tmp_path):
    (tmp_path / "mine").mkdir()
    with pytest.raises(FolderExistsError, match="mine: exists"):
        write_report(diagnosis, tmp_path / "mine")
    assert list((tmp_path / "mine").iterdir()) == []


def test_the_headline_of_unknown_says_first_what_a_refit_explains(diagnosis):
    few = tuple(replace(c, baseline=1.0, refit=0.01) for c in diagnosis.gain.channels)
    moved = (Moved("gain", 0.21, Estimate(0.17, 0.169, 0.171, "N m/A"), 6.6),)
    left = replace(
        diagnosis, verdict="unknown", gain=replace(diagnosis.gain, channels=few, as_given=False), moved=moved
    )
    text = headline(left)
    assert text.startswith("gain is 0.17 N m/A, not 0.21 N m/A")
    assert "explains most of the difference once its own parameters are refitted" in text
    assert text.endswith("it still differs from this log, and no cause of the catalogue explains the rest")
    none = replace(
        left, gain=replace(left.gain, channels=tuple(replace(c, refit=0.9) for c in few)), moved=()
    )
    assert headline(none) == (
        "The simulation differs from this log, and no cause of the catalogue explains the difference"
    )


def test_headline_and_lead_name_the_cause(diagnosis):
    assert headline(diagnosis) == "The simulation lacks: coulomb"
    assert "Dry friction" in lead(diagnosis)


@pytest.mark.study
def test_report_shows_the_warnings_of_reading_and_of_the_model_file(whole, tmp_path):
    said, left = "torque is not known from 2.1 to 2.4 s", "limits of joints are not simulated: elbow"
    doubted = replace(
        whole,
        data={
            **whole.data,
            "model": [left],
            "logs": [{**log, "warnings": [said]} for log in whole.data["logs"]],
        },
    )
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(terminal_table(doubted))
    text, page = console.export_text(), write_report(doubted, tmp_path / "out").read_text()
    for sentence in (said, left):
        assert sentence in text
        assert f"<li>{sentence}</li>" in page


@pytest.mark.parametrize(("sds", "said"), [(3.0, True), (-3.0, True), (1.0, False)])
def test_the_terminal_says_which_parameter_of_a_silent_refit_is_far_from_its_given_value(
    diagnosis, sds, said
):
    mean, sd = diagnosis.details.priors["mass"]
    final = {**diagnosis.final, "mass": replace(diagnosis.final["mass"], value=mean + sds * sd)}
    silent = replace(diagnosis, verdict="nothing", causes=(), final=final)
    console = Console(width=300, record=True, file=io.StringIO())
    console.print(terminal_table(silent))
    text = console.export_text()
    assert ("The refit moved mass farthest" in text) == said
    assert ("3.0 standard deviations of what is stated about it" in text) == said


@pytest.mark.study
def test_healthy_log_adds_its_effects_to_the_baseline():
    worn = {"lag": {"time_constant": 0.006}}
    parameters = 72  # the same unit: same seed, same parameters
    healthy = unit_log("rod_pendulum", worn, "chirp", parameters, 20.0)
    broken = unit_log("rod_pendulum", {**worn, "coulomb": {"torque": 0.05}}, "steps", parameters, 20.0)
    result = diagnose([broken], "rod_pendulum", healthy=[healthy])
    assert result.names == ("coulomb",)


@pytest.mark.study
def test_holdout_logs_are_never_fitted(log, whole):
    other = unit_log("rod_pendulum", HIDDEN, "chirp", 71, 6.0)
    result = diagnose([log], "rod_pendulum", holdout=[other])
    assert result.verdict == "cause"
    assert result.gain.windows == 4
    assert set(result.gain.replayed.log) == {0}
    assert result.windows > whole.windows


@pytest.mark.study
def test_model_keeps_given_parameters_where_the_refit_raises_the_held_out_error():
    mine, other, another = (unit_log("rod_pendulum", {}, "steps", seed, 12.0) for seed in (81, 82, 83))
    given = diagnose([other], "rod_pendulum", only=["lag"]).model
    worse = diagnose([mine], given, holdout=[other], only=["lag"])
    assert worse.verdict == "nothing"
    assert worse.gain.as_given
    channel = worse.gain.channels[0]
    assert channel.extended == channel.baseline < channel.refit
    assert worse.gain.low <= worse.gain.reduction <= worse.gain.high
    assert {p.name: p.value for p in worse.model.parameters} == {p.name: p.value for p in given.parameters}
    assert worse.model.effects == given.effects
    assert "as given" in worse.gain_note
    better = diagnose([another], given, holdout=[another], only=["lag"])
    assert not better.gain.as_given
    assert better.gain.channels[0].extended < better.gain.channels[0].baseline


def test_command_line_diagnoses(commanded):
    assert commanded.status == 0
    assert json.loads(commanded.printed) == json.loads((commanded.folder / "report.json").read_text())
    assert json.loads(commanded.printed)["verdict"] == "cause"
    assert (commanded.folder / "report.html").is_file()


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self):
        return True


@pytest.mark.parametrize(("stream", "options"), [(Terminal, []), (Terminal, ["--json"]), (io.StringIO, [])])
def test_diagnose_command_shows_progress_on_a_terminal_only(log, tmp_path, monkeypatch, stream, options):
    path = write_log(tmp_path / "log.csv", log)
    monkeypatch.setattr("sys.stderr", stream())
    monkeypatch.setattr("deepkoco.diagnose.report.folder.write_report", lambda result, out: out)
    monkeypatch.setattr("deepkoco.diagnose.report.text.terminal_table", lambda result: result.verdict)
    monkeypatch.setattr(import_module("deepkoco.diagnose.diagnose"), "diagnose", told)
    assert (
        main(["diagnose", str(path), "--system", "rod_pendulum", "--out", str(tmp_path / "o"), *options]) == 3
    )
    shown = sys.stderr.getvalue()
    assert ("fitting every [b]cause" in shown) == (stream is Terminal and not options)
    assert stream is Terminal or shown == ""


def told(*_, progress, evidence, time_limit):
    """A diagnosis that ends at once."""
    assert evidence is False
    assert time_limit is None
    progress("fitting every [b]cause")
    time.sleep(0.2)  # the line is drawn ten times a second
    return SimpleNamespace(verdict="insufficient", to_json=dict)


@pytest.mark.parametrize("window", [[], ["--window", "25"]])
def test_diagnose_command_says_what_is_missing_where_the_joint_rests(log, tmp_path, capsys, window):
    rng = np.random.default_rng(0)
    t = log.channels["theta"].t
    still = {
        "theta": Series(t, np.pi + 0.002 * rng.standard_normal(len(t)), "rad", "measurement"),
        "omega": Series(t, 0.05 * rng.standard_normal(len(t)), "rad/s", "measurement"),
    }
    path = write_log(tmp_path / "still.csv", replace(log, channels={**log.channels, **still}))
    assert main(["diagnose", str(path), "--out", str(tmp_path / "out"), *window]) == 3
    assert "moves" in capsys.readouterr().out
    assert json.loads((tmp_path / "out" / "report.json").read_text())["verdict"] == "insufficient"
    assert not (tmp_path / "out" / "model.yaml").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--system", "unicycle"], "unicycle"),
        (["--out", "{folder}"], "exists"),
        (["--window", "-1"], "--window"),
        (["--healthy", "{folder}/none.csv"], "none.csv"),
        (["--system", "{folder}/none.yaml"], "none.yaml"),
    ],
)
def test_diagnose_command_reports_bad_input_in_one_line_with_status_2(
    log, tmp_path, capsys, arguments, message
):
    path = write_log(tmp_path / "log.csv", log)
    before = sorted(tmp_path.iterdir())
    given = [a.format(folder=tmp_path) for a in arguments]
    assert main(["diagnose", str(path), *given]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before
