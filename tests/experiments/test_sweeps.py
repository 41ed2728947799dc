"""What a sweep tells in the end, which launchers it takes, and that one process trains in a folder."""

import subprocess
import sys

import pytest

from deepkoco.runs import sweep
from deepkoco.runs.run_lock import locked
from deepkoco.runs.settings import ExperimentError
from deepkoco.runs.sweep import Failure, SweepFailed, check_launcher, conclude

JOBS = [["seed=0", "task=a"], ["seed=1", "task=a"], ["seed=2", "task=a"]]


def never(job):
    return False


def test_a_sweep_without_failures_says_nothing(capsys):
    conclude(JOBS, [None, None, None], never)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("crash", "status"), [(None, 2), (Failure("boom"), 1)])
def test_failures_are_listed_by_what_tells_them_apart(crash, status, capsys):
    with pytest.raises(SweepFailed) as stop:
        conclude(JOBS, [None, Failure("seed is odd", refused=True), crash], never)
    assert stop.value.code == status
    told = capsys.readouterr().err.splitlines()
    assert told[0] == f"error: {1 + (crash is not None)} of 3 runs failed:"
    assert told[1] == "  seed=1: seed is odd"


def test_after_a_launcher_breaks_off_the_folders_tell_what_is_left(capsys):
    with pytest.raises(SweepFailed) as stop:
        conclude(JOBS, None, lambda job: job[0] == "seed=1", RuntimeError("a worker\ndied"))
    assert stop.value.code == 1
    told = capsys.readouterr().err.splitlines()
    assert told[0] == "error: the sweep was broken off: RuntimeError: a worker died"
    assert told[2:4] == ["  seed=0: not finished", "  seed=2: not finished"]


def test_a_launcher_that_is_not_installed_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sweep.LAUNCHERS, "moon", ("hydra_plugins.moon_launcher", "space"))
    with pytest.raises(ExperimentError, match=r'pip install -e "\.\[space\]"'):
        check_launcher(["train", "-m", "hydra/launcher=moon"])
    check_launcher(["train", "-m", "seed=0,1"])


def test_a_folder_is_trained_in_by_one_process(tmp_path):
    path = tmp_path / "config.yaml"
    path.touch()
    code = f"""
import fcntl
with open({str(path)!r}, "r+b") as file:
    fcntl.flock(file, fcntl.LOCK_EX)
    print("held", flush=True)
    input()
"""
    other = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None
    assert other.stdout.readline() == "held\n"
    with pytest.raises(ExperimentError, match="another process trains there"), locked(path, wait=False):
        pass
    other.kill()  # the lock of a process that dies is free
    other.wait()
    with locked(path, wait=False):
        pass
