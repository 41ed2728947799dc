"""The results of the study of hidden effects, from made-up rows."""

import csv
import json

import pytest

from experiments.studies.diagnosis.hidden.goals import GOALS, reached
from experiments.studies.diagnosis.hidden.power import confusion, power
from experiments.studies.diagnosis.hidden_effects import COLUMNS
from experiments.studies.diagnosis.hidden_results import main


def row(seed, kind, hidden, strength, verdict, classes, condition="clean"):
    base = dict.fromkeys(COLUMNS, "")
    return base | {
        "index": str(seed - 2000),
        "seed": str(seed),
        "system": "pendulum",
        "condition": condition,
        "kind": kind,
        "hidden": hidden,
        "ES": strength,
        "verdict": verdict,
        "classes": json.dumps(classes),
        "parameters": "[]",
        "chi2_before": "2.0",
        "cpu_s": "1.0",
        "commit": "abc",
    }


ROWS = [
    row(2000, "control", "", "", "nothing", []),
    row(2001, "single", "gain", "0.5", "cause", [["gain"]]),
    row(2002, "single", "gain", "0.6", "ambiguous", [["payload", "gain"], ["lag"]]),
    row(2003, "single", "noise_level(omega)", "0.6", "nothing", []),
    row(2004, "outside", "turbulence", "2.0", "unknown", [["unknown"]]),
    row(2005, "pair", "gain + lag", "1.0 + 1.0", "cause", [["gain"], ["lag"]]),
]


def write(path, rows):
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def test_power_counts_hits_by_strength():
    found = {(x["measure"], x["ES_from"]): (x["count"], x["of"]) for x in power(ROWS)}
    assert found["detected", 0.45] == (2, 3)
    assert found["true cause in the first class", 0.45] == (2, 3)
    assert found["true cause named first", 0.45] == (1, 3)


def test_confusion_names_kinds_and_leaves_pairs_out():
    found = {(x["hidden"], x["named"]): x["cases"] for x in confusion(ROWS)}
    assert found == {
        ("nothing", "nothing"): 1,
        ("gain", "gain"): 1,
        ("gain", "payload"): 1,
        ("noise_level", "nothing"): 1,
        ("turbulence", "unknown"): 1,
    }


def test_goals_depend_on_the_condition():
    naming = next(g for g in GOALS if g.measure == "top_1_in_class")
    share = {"share": 0.92, "low": 0.8, "high": 0.99}
    assert reached(naming, "clean", share) is False
    assert reached(naming, "floor", share) is True
    assert reached(naming, "floor", {"share": None}) is None
    exact = next(g for g in GOALS if g.measure == "exact_top_1")
    assert reached(exact, "bang-bang", share) is None
    cover = next(g for g in GOALS if g.measure == "interval_coverage")
    assert reached(cover, "clean", {"share": 1.0, "low": 0.7, "high": 1.0}) is True
    assert reached(cover, "clean", {"share": 1.0, "low": 0.995, "high": 1.0}) is False


def test_results_are_written_from_partial_rows(tmp_path):
    rows, out = tmp_path / "rows", tmp_path / "out"
    rows.mkdir()
    write(rows / "a.csv", ROWS)
    # The other study is under way: its last row is not whole yet.
    write(rows / "b.csv", [row(2000, "control", "", "", "cause", [["lag"]], "floor")])
    with (rows / "b.csv").open("a") as file:
        file.write("1,2001,pendu")
    shown = []
    assert main(["--rows", str(rows), "--out", str(out)], shown.append) == 0
    assert "| false alarms on controls | <= 3.33 % | 0/1 (0 to 79 %) | **1/1 (21 to 100 %)** |" in shown[0]
    with (out / "rows.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(ROWS) + 1
    names = {path.name for path in out.iterdir()}
    assert {"README.md", "power.csv", "power.png", "confusion.csv", "confusion_pendulum_clean.png"} <= names
    assert "2000 to 2005 | abc" in (out / "README.md").read_text()


@pytest.mark.parametrize("twice", [True, False])
def test_rows_that_do_not_fit_together_are_refused(tmp_path, twice, capsys):
    if twice:
        write(tmp_path / "a.csv", ROWS)
        write(tmp_path / "b.csv", ROWS[:1])
    assert main(["--rows", str(tmp_path), "--out", str(tmp_path / "out")], lambda text: None) == 2
    assert ("there twice" if twice else "has no rows") in capsys.readouterr().err
