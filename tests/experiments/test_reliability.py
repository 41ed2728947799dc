"""What stated probabilities are worth, from rows worked out by hand."""

import csv
import json

import pytest

from experiments.studies.diagnosis.reliability import binned, main, statements, table_of


def row(kind, hidden, *places):
    return {"kind": kind, "hidden": hidden, "probabilities": json.dumps(places)}


def test_a_statement_is_true_where_it_names_what_was_hidden():
    single = row("single", "payload", {"payload": 0.87, "gain": 0.08, "unknown": 0.05})
    assert statements(single) == [(0.87, True), (0.08, False), (0.05, False)]
    assert statements(row("control", "", {"nothing": 0.95, "unknown": 0.05})) == [(0.95, True), (0.05, False)]
    assert statements(row("single", "gain", {"nothing": 0.9, "gain": 0.1})) == [(0.9, False), (0.1, True)]
    # What is outside of the catalogue is "unknown", also where a cause of the catalogue has its name.
    assert statements(row("outside", "tether", {"spring": 0.95, "unknown": 0.05})) == [
        (0.95, False),
        (0.05, True),
    ]


def test_nothing_beside_the_last_of_two_causes_is_true():
    pair = row(
        "pair", "gain + lag", {"gain": 1.0}, {"lag": 0.6, "nothing": 0.3}, {"bias": 0.5, "nothing": 0.5}
    )
    assert statements(pair) == [(1.0, True), (0.6, True), (0.3, False), (0.5, False), (0.5, True)]


def test_shares_of_each_range_have_wilsons_intervals():
    by_size = {(b["from"], b["to"]): b for b in binned([(0.95, True)] * 9 + [(0.95, False), (0.1, False)])}
    sure = by_size[0.9, 0.99]
    assert (sure["count"], sure["of"]) == (9, 10)
    assert sure["stated"] == pytest.approx(0.95)
    assert sure["low"] < 0.9 < sure["high"]
    assert "| 0.9 to 0.99 | 0.950 | 9 | 10 | 0.90 [" in table_of(list(by_size.values()))


def test_table_and_curve_are_written_from_all_files_that_hold_probabilities(tmp_path):
    rows = tmp_path / "rows"
    rows.mkdir()
    for name, found in (
        ("new.csv", [row("control", "", {"nothing": 0.95})]),
        ("old.csv", [{"kind": "control"}]),
    ):
        with (rows / name).open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(found[0]))
            writer.writeheader()
            writer.writerows(found)
    main(["--rows", str(rows), "--out", str(tmp_path / "out")])
    table = list(csv.DictReader((tmp_path / "out" / "reliability.csv").read_text().splitlines()))
    assert [r["count"] for r in table if r["of"] != "0"] == ["1"]
    assert (tmp_path / "out" / "reliability.png").stat().st_size > 1000
    (rows / "new.csv").unlink()
    with pytest.raises(SystemExit):
        main(["--rows", str(rows), "--out", str(tmp_path / "out")])
