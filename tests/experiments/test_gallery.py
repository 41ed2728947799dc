"""The gallery of diagnoses: what is kept of each case, and its index."""

import json
import re
from pathlib import Path

import pytest

from deepkoco.diagnose import diagnose
from deepkoco.logs.recording import LogError
from experiments.studies.diagnosis import gallery
from experiments.studies.diagnosis.gallery import EXHIBITS, Exhibit, index, main, make
from experiments.studies.diagnosis.hidden.recorded import unit_log
from experiments.studies.diagnosis.real_log_studies import STUDIES


@pytest.fixture(scope="module")
def exhibit():
    def run(_: Path):
        log = unit_log("rod_pendulum", {"torque_bias": {"effort": 0.3}}, "steps", 5, 15.0)
        return diagnose([log], "rod_pendulum", only=["torque_bias", "coulomb", "gain"])

    return Exhibit("hidden_delay", "A rod.", "0.3 N m of bias.", run)


@pytest.mark.study
def test_an_exhibit_keeps_what_the_page_does_not_hold(exhibit, tmp_path):
    make(exhibit, tmp_path, tmp_path)
    folder = tmp_path / exhibit.name
    names = {path.name for path in folder.iterdir()}
    assert {"report.html", "report.json", "model.yaml", "terminal.txt", "PROVENANCE.md"} <= names
    assert not any(name.endswith(".png") for name in names)
    page = (folder / "report.html").read_text()
    assert len(page) < 1_500_000
    # Every file that the page links to is beside it.
    assert set(re.findall(r'<a href="([^"]+)"', page)) <= names
    assert "torque bias" in (folder / "terminal.txt").read_text()
    row = index(tmp_path).splitlines()[-1]
    assert row.startswith("| [hidden_delay](hidden_delay/report.html)")
    assert "| cause | torque_bias (0.3 N m) |" in row


def test_a_case_that_is_there_is_left_alone_and_one_that_fails_spoils_no_other(monkeypatch, tmp_path, capsys):
    def missing(_: Path):
        raise LogError("log.csv: no such file")

    there = tmp_path / "there"
    there.mkdir()
    (there / "report.json").write_text(json.dumps({"verdict": "nothing", "causes": []}))
    cases = (Exhibit("broken", "a", "b", missing), Exhibit("there", "a", "b", missing))
    monkeypatch.setattr(gallery, "EXHIBITS", cases)
    assert main(["--out", str(tmp_path)]) == 2
    shown = capsys.readouterr()
    assert "there: there already" in shown.out
    assert "error: broken: log.csv: no such file" in shown.err
    assert "| nothing | nothing |" in (tmp_path / "README.md").read_text()
    assert not (tmp_path / "broken").exists()


def test_real_cases_ask_questions_that_are_studied():
    real = [e for e in EXHIBITS if e.real]
    assert len(real) >= 3
    assert len(EXHIBITS) - len(real) >= 3
    for exhibit in real:
        closed = {c.cell_contents for c in exhibit.diagnose.__closure__ or ()}
        log = next(name for name in closed if name in STUDIES)
        assert closed - {log} <= set(STUDIES[log].questions)
