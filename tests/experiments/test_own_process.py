"""Runs of a study in processes of their own: done once, and named where they fail."""

import json

import pytest

from deepkoco.runs.settings import ExperimentError
from experiments.plumbing import own_process

WRITER = """
import json, os, sys
method, seed, path, *options = sys.argv[1:]
with open(path, "w") as file:
    json.dump({"found": [method, seed, *options], "threads": os.environ["OMP_NUM_THREADS"]}, file)
"""


def test_a_run_is_kept_with_what_it_took_and_not_done_again(tmp_path, monkeypatch):
    (tmp_path / "a_run.py").write_text(WRITER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    own_process.run_once("a_run", "ours", 3, tmp_path, ["--fast"])
    kept = json.loads((tmp_path / "ours_3.json").read_text())
    assert (kept["method"], kept["seed"], kept["options"]) == ("ours", 3, "--fast")
    assert (kept["found"], kept["threads"]) == (["ours", "3", "--fast"], "1")
    assert 0.0 < kept["cpu_seconds"] < 60.0
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix in (".json", ".part")) == [
        "ours_3.json"
    ]
    monkeypatch.setattr(own_process.sys, "executable", "/bin/false")
    own_process.run_once("a_run", "ours", 3, tmp_path)


def test_a_run_that_fails_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(own_process.sys, "executable", "/bin/false")
    with pytest.raises(ExperimentError, match="stacked, seed 3: the run ended with status 1"):
        own_process.run_once("a_run", "stacked", 3, tmp_path)
