"""The study of damaged logs: it goes on where it was, and diagnoses a recording once."""

import json

import pytest

pytest.importorskip("hypothesis")

from experiments.plumbing.rows import append_row, read_rows
from experiments.studies.diagnosis import fuzz_logs
from experiments.studies.diagnosis.fuzz_logs import FuzzCase, Verdict, content_key, read_case, run_cases


def test_formats_of_one_log_share_a_verdict_and_a_changed_value_does_not():
    clean = [read_case(FuzzCase(0, form, ("none",), 0))[1] for form in ("csv", "parquet", "mcap")]
    keys = {content_key(recording, "rod_pendulum") for recording in clean if recording is not None}
    assert len(keys) == 1
    other = read_case(FuzzCase(0, "csv", ("repeated rows",), 0))[1]
    scaled = read_case(FuzzCase(0, "csv", ("command in other unit",), 0))[1]
    assert scaled is not None
    assert content_key(scaled, "rod_pendulum") not in keys
    assert other is None or other.warnings or content_key(other, "rod_pendulum") in keys


def test_a_study_goes_on_after_a_kill(tmp_path, monkeypatch):
    asked = [FuzzCase(0, form, ("none",), seed) for form in ("csv", "parquet") for seed in (1, 2)]
    calls = []

    def diagnosed(self, recording, system):
        calls.append(system)
        return Verdict("nothing", ())

    monkeypatch.setattr(fuzz_logs.Verdicts, "of", diagnosed)
    path = tmp_path / "seed_0.jsonl"
    first = run_cases(asked[:2], path, tmp_path / "verdicts.jsonl")
    with path.open("ab") as file:
        file.write(b'{"case": {"base"')  # what a kill leaves
    count = len(calls)
    rows = run_cases(asked, path, tmp_path / "verdicts.jsonl")
    assert len(calls) == 2 * count
    assert rows[:2] == first
    assert [row["outcome"] for row in rows] == ["nothing"] * 4
    assert len(read_rows(path)) == 4


def test_rows_of_other_sources_are_run_again(tmp_path):
    case = FuzzCase(0, "csv", ("empty file",), 0)
    path = tmp_path / "rows.jsonl"
    run_cases([case], path, tmp_path / "verdicts.jsonl")
    row = read_rows(path)[0] | {"source": "older", "outcome": "traceback"}
    path.unlink()
    append_row(path, json.loads(json.dumps(row)))
    assert run_cases([case], path, tmp_path / "verdicts.jsonl")[0]["outcome"] == "refused"
