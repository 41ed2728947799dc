"""Tables of the study of both methods, from rows worked out by hand."""

import json

import pytest

from experiments.studies.diagnosis.shadow import COLUMNS, main, reliability, summary, table_of


def row(kind: str, hidden: str, strength: float, nothing: float, chances: dict[str, float], **more) -> dict:
    true = [chances.get(n, 0.0) for n in hidden.split(" + ")] if kind in ("single", "pair") else []
    found = {
        **dict.fromkeys(COLUMNS, ""),
        "system": "rod_pendulum",
        "kind": kind,
        "hidden": hidden,
        "ES": strength,
        "top": "x",
        "nothing": nothing,
        "unknown": chances.get("unknown", 0.0),
        "true": json.dumps(true),
        "in_set": int(all(t > 0.05 for t in true)) if true else "",
        "set_size": 1,
        "probabilities": json.dumps(chances),
        "cpu_evidence": 2.0,
    }
    return found | more


ROWS = [
    row("control", "", 0.0, 0.97, {"gain": 0.03}),
    row("control", "", 0.0, 0.30, {"gain": 0.70}),
    row("single", "coulomb", 1.0, 0.0, {"coulomb": 0.95, "stribeck": 0.05}),
    row("single", "lag", 1.0, 0.0, {"low_pass": 0.6, "lag": 0.4}),
    row("single", "tilt", 0.1, 0.9, {"tilt": 0.1}),
    row("pair", "gain + lag", 2.0, 0.0, {"gain": 1.0, "lag": 0.8}),
    row("outside", "tether", 2.0, 0.0, {"unknown": 0.9, "spring": 0.1}),
]


def test_measures_count_what_each_method_said():
    both = {"verdict": "cause", "named": '[["coulomb"]]', "first_right": 1, "cpu_present": 5.0}
    found = summary(
        [ROWS[0] | {"verdict": "nothing", "named": "[]", "first_right": 0}, *ROWS[1:2], ROWS[2] | both]
    )
    assert found["present"]["false alarms"]["of"] == 1
    assert found["present"]["singles, first in class"]["count"] == 1
    told = summary(ROWS)["evidence"]
    shares = {name: (told[name]["count"], told[name]["of"]) for name in told if isinstance(told[name], dict)}
    assert shares["false alarms"] == (1, 2)
    assert shares["names a cause of a healthy unit"] == (1, 2)
    assert shares["singles, first in class"] == (1, 2)
    assert shares["singles, in the 95 % set"] == (2, 2)
    assert shares["weak singles, in the 95 % set"] == (1, 1)
    assert shares["pairs, both named"] == (1, 1)
    assert shares["outside, unknown"] == (1, 1)
    assert shares["outside, names a cause"] == (0, 1)


def test_reliability_counts_true_statements_of_each_size():
    by_size = {(r["from"], r["to"]): (r["count"], r["of"]) for r in reliability(ROWS)}
    # 0.97 of a healthy unit, 0.95 of the friction; nothing 0.9 of the tilt stands one row lower.
    assert by_size[0.9, 0.99] == (2, 2)
    assert by_size[0.8, 0.9] == (0, 1)
    # 0.70 of a gain that is none, 0.6 of a filter that is a lag, 0.8 of the lag of the pair.
    assert by_size[0.5, 0.8] == (1, 3)


def test_a_row_without_an_answer_counts_as_failed():
    found = summary([*ROWS, {**dict.fromkeys(COLUMNS, ""), "note": "DivergedError"}])
    assert (found["cases"], found["failed"]) == (8, 1)
    assert "| median CPU s |" in table_of(found)


@pytest.mark.study
def test_the_study_goes_on_where_it_was_stopped(tmp_path):
    asked = ["--seed", "20500", "--seconds", "10", "--out", str(tmp_path), "--alone", "--cases"]
    main([*asked, "1"])
    first = (tmp_path / "rows.csv").read_text()
    main([*asked, "2"])
    assert (tmp_path / "rows.csv").read_text().startswith(first)
