"""Files and folders appear whole or not at all, and a refused write is told in one sentence."""

import errno
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from matplotlib.figure import Figure

from deepkoco.agent.checkpoint import load_checkpoint, save_checkpoint
from deepkoco.agent.metrics import write_rows
from deepkoco.koopman.files.folder_files import write_files
from deepkoco.logs.recording import Recording, Series, read_log, write_log
from deepkoco.output.new_folder import check_new, new_folder
from deepkoco.output.whole_file import WriteError, system_error, whole_file, write_whole_text, writing
from deepkoco.systems import make_system, save_model
from tests.full_disk import everything_in, largest_file, read_only


def _log(values: int) -> Recording:
    t = np.arange(values) / 100
    series = {n: Series(t, np.sin(t + k), u, kind) for k, (n, u, kind) in enumerate(CHANNELS)}
    return Recording(series, system="rod_pendulum")


CHANNELS = (
    ("torque", "N m", "command"),
    ("theta", "rad", "measurement"),
    ("theta_dot", "rad/s", "measurement"),
)


def _in_a_new_folder(path: Path) -> None:
    with new_folder(path) as folder:
        (folder / "first.txt").write_text("short")
        (folder / "second.txt").write_bytes(bytes(100_000))


def _figure(path: Path) -> None:
    with whole_file(path) as partial:
        Figure().savefig(partial, dpi=400)


def _table(path: Path) -> None:
    table = pd.DataFrame({"a": np.random.default_rng(0).random(5000)})
    with whole_file(path) as partial:
        (table.to_csv if path.suffix == ".csv" else table.to_parquet)(partial)


WRITERS = {
    "text.txt": lambda path: write_whole_text(path, "x" * 100_000),
    "picture.png": _figure,
    "table.csv": _table,
    "table.parquet": _table,
    "checkpoint.pt": lambda path: save_checkpoint(path, {"weights": torch.zeros(20_000)}),
    "metrics.csv": lambda path: write_rows(path, [{"episodes": float(k), "cost": 1 / 3} for k in range(500)]),
    "model.yaml": lambda path: save_model(path, make_system("rod_pendulum"), {"logs": ["x" * 5000]}),
    "log.csv": lambda path: write_log(path, _log(2000)),
    "folder": _in_a_new_folder,
    "model": lambda path: write_files(path, {}, {"w": np.zeros((100, 100))}, "card"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_told_in_one_sentence_and_nothing_is_left(tmp_path, name):
    path = tmp_path / name
    with pytest.raises(WriteError) as told, largest_file(4000):
        WRITERS[name](path)
    assert str(told.value).startswith(f"{path}: cannot be written: ")
    assert "; raise the limit on the size of files" in str(told.value)
    assert told.value.errno == errno.EFBIG
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", WRITERS)
def test_a_folder_that_cannot_be_written_is_told_in_one_sentence(tmp_path, name):
    path = tmp_path / name
    with pytest.raises(WriteError) as told, read_only(tmp_path):
        WRITERS[name](path)
    sentence = "cannot be written: permission denied; choose a place that you may write to"
    # Of a log the sidecar is written first.
    assert str(told.value).replace("log.yaml", "log.csv").startswith(f"{path}: {sentence}")
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_the_checkpoint_that_was_there(tmp_path):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, {"step": 1})
    with pytest.raises(WriteError), largest_file(4000):
        save_checkpoint(path, {"step": 2, "weights": torch.zeros(20_000)})
    assert load_checkpoint(path) == {"step": 1}
    assert list(tmp_path.iterdir()) == [path]


def test_a_log_whose_table_is_not_written_leaves_no_sidecar(tmp_path):
    with pytest.raises(WriteError), largest_file(4000):
        write_log(tmp_path / "log.csv", _log(2000))
    assert not list(tmp_path.iterdir())
    write_log(tmp_path / "log.csv", _log(2000))
    assert read_log(tmp_path / "log.csv").system == "rod_pendulum"


def test_a_new_folder_is_refused_before_any_work_where_it_cannot_be_written(tmp_path):
    with pytest.raises(WriteError, match="permission denied"), read_only(tmp_path):
        check_new(tmp_path / "deep" / "report")
    check_new(tmp_path / "deep" / "report")
    assert not list(tmp_path.iterdir())


def test_whole_file_replaces_a_file_only_when_all_is_written(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("before")
    with pytest.raises(TypeError), whole_file(path) as partial:
        partial.write_text("half") + "a length"
    assert everything_in(tmp_path) == {"a.txt": b"before"}
    with whole_file(path) as partial:
        partial.write_text("after")
        assert partial.suffix == path.suffix
    assert everything_in(tmp_path) == {"a.txt": b"after"}


def test_an_error_about_another_file_passes_unchanged(tmp_path):
    with pytest.raises(FileNotFoundError) as told, writing(tmp_path / "out.txt"):
        (tmp_path / "input.txt").read_text()
    assert system_error(told.value) == f"{tmp_path / 'input.txt'}: no such file or directory"


def test_a_file_in_an_unfinished_folder_is_told_by_the_folders_own_name(tmp_path):
    with pytest.raises(WriteError) as told, largest_file(4000), new_folder(tmp_path / "report") as folder:
        write_whole_text(folder / "page.html", "x" * 10_000)
    assert str(told.value).startswith(f"{tmp_path / 'report'}: cannot be written")
