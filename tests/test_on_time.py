"""Failures for want of time are repeated, others are not."""

import time

import pytest

from tests import on_time as module
from tests.on_time import Waiting, on_time


def failing(times: int, calls: list[int]):
    @on_time
    def test(tmp_path):
        calls.append(len(list(tmp_path.iterdir())))
        (tmp_path / "mark").touch()
        assert len(calls) > times

    return test


def test_a_failure_while_threads_wait_is_repeated_in_a_new_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "LATE", 0.0)
    calls: list[int] = []
    failing(2, calls)(tmp_path=tmp_path)
    assert calls == [0, 0, 0]


def test_a_failure_on_a_machine_with_time_counts_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "LATE", 1e9)
    monkeypatch.setattr(module, "busy", lambda: False)
    calls: list[int] = []
    with pytest.raises(AssertionError):
        failing(2, calls)(tmp_path=tmp_path)
    assert len(calls) == 1


def test_a_failure_while_other_processes_wait_is_repeated(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "LATE", 1e9)
    monkeypatch.setattr(module, "busy", lambda: True)
    calls: list[int] = []
    failing(2, calls)(tmp_path=tmp_path)
    assert len(calls) == 3


@pytest.mark.parametrize(("load", "waits"), [(1.9, False), (2.1, True)])
def test_a_machine_is_busy_when_more_processes_want_to_run_than_there_are_cores(monkeypatch, load, waits):
    monkeypatch.setattr("os.getloadavg", lambda: (load, 0.0, 0.0))
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert module.busy() is waits


def test_the_last_failure_counts(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "LATE", 0.0)
    calls: list[int] = []
    with pytest.raises(AssertionError):
        failing(100, calls)(tmp_path=tmp_path)
    assert len(calls) == module.ATTEMPTS


def test_a_test_that_raises_nothing_where_it_should_is_repeated_too(monkeypatch):
    monkeypatch.setattr(module, "LATE", 0.0)
    calls: list[int] = []

    def late(attempt: int) -> None:
        if attempt > 1:
            raise ValueError("late")

    @on_time
    def test():
        calls.append(1)
        with pytest.raises(ValueError, match="late"):
            late(len(calls))

    test()
    assert len(calls) == 2


def test_a_thread_that_gets_no_turn_is_seen_to_wait():
    with Waiting() as waiting:
        time.sleep(0.01)
        sum(range(20_000_000))  # one call into C, during which no other thread runs
    assert waiting.longest > 0.02
