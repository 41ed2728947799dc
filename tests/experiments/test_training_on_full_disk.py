"""Training on a disk that fills up ends in one sentence and goes on from its last checkpoint."""

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from experiments.plumbing.rows import append_row, read_rows
from tests.experiments.conftest import SMALL
from tests.full_disk import largest_file

ROOT = Path(__file__).resolve().parents[2]


def _train(largest: int | None, *arguments: str) -> subprocess.CompletedProcess[str]:
    limit = (
        ""
        if largest is None
        else f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({largest}, -1)); "
    )
    run = "sys.argv[0] = 'train'; runpy.run_module('experiments.train', run_name='__main__')"
    # A compiled module of which only a part could be written would stay for all later imports.
    start = f"import runpy, sys; sys.dont_write_bytecode = True; {limit}{run}"
    line = [sys.executable, "-c", start, *arguments]
    return subprocess.run(line, capture_output=True, text=True, cwd=ROOT, check=False)


@pytest.mark.study
@pytest.mark.timeout(300)
def test_training_without_room_for_a_checkpoint_is_told_and_leaves_nothing(tmp_path):
    done = _train(20_000, *SMALL, f"run={tmp_path / 'run'}", "seed=3")
    assert done.returncode == 2
    assert done.stderr == (
        f"error: {tmp_path / 'run' / 'checkpoint.pt'}: cannot be written: file too large; "
        "raise the limit on the size of files (ulimit -f) or choose another disk\n"
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.study
@pytest.mark.long
@pytest.mark.timeout(300)
def test_training_that_ran_out_of_room_goes_on_from_its_last_checkpoint(tmp_path):
    run = tmp_path / "run"
    first = _train(None, *SMALL, "agent.total_episodes=4", f"run={run}", "seed=3")
    assert first.returncode == 0, first.stderr
    size = (run / "checkpoint.pt").stat().st_size
    # The checkpoint of the second iteration holds more episodes than that of the first.
    other = tmp_path / "other"
    stopped = _train(size + 200, *SMALL, f"run={other}", "seed=3")
    assert stopped.returncode == 2
    assert f"then go on from the last checkpoint with resume={other}" in stopped.stderr
    assert _train(None, f"resume={other}").returncode == 0
    assert pd.read_csv(other / "metrics.csv")["episodes"].tolist() == [4, 6, 7]


def test_a_row_that_finds_no_room_is_told_and_the_rows_before_it_stay(tmp_path):
    path = tmp_path / "rows.jsonl"
    append_row(path, {"a": 1})
    with pytest.raises(OSError, match=r"rows\.jsonl: cannot be written: file too large"), largest_file(100):
        append_row(path, {"b": "x" * 500})
    assert read_rows(path) == [{"a": 1}]
    append_row(path, {"c": 2})
    assert read_rows(path) == [{"a": 1}, {"c": 2}]
