"""The unit in its own process, in wall-clock time."""

import math
import os
import signal
import subprocess
import sys
import time
from itertools import pairwise

import pytest

from deepkoco.unit import Unit, UnitError, make_unit
from deepkoco.unit.messages import COMMAND_FRAME, Order
from tests.on_time import on_time

SPEC = make_unit("rod_pendulum", sensor={"noise_sd": {"theta": 0.0, "omega": 0.0}}, heartbeat=0.3)


def receive_until(unit: Unit, t: float):
    message = unit.receive()
    while message.t_received < t:
        message = unit.receive()
    return message


def drain(unit: Unit, timeout: float) -> None:
    while True:
        unit.receive(timeout)


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@on_time
def test_unit_runs_in_real_time_and_stops_itself_without_commands():
    with Unit(SPEC) as unit:
        first = unit.reset()
        assert first.values == pytest.approx((math.pi, 0.0), abs=1e-6)
        began = time.monotonic()
        unit.send(2.0)
        driven = receive_until(unit, 0.2)
        assert time.monotonic() - began == pytest.approx(0.2, abs=0.15)
        assert driven.values[0] > math.pi + 0.05  # theta'' = 6 rad/s2 for some 0.2 s
        assert driven.stops == 0
        assert driven.seq - first.seq == pytest.approx(20, abs=10)
        stopped = receive_until(unit, 0.5)
        assert stopped.stops == 1


@on_time
def test_reset_starts_anew_from_the_state_given():
    with Unit(SPEC) as unit:
        unit.send(2.0)
        receive_until(unit, 0.1)
        message = unit.reset((0.5, -1.0))
        assert message.seq <= 20  # 0 on an idle machine
        age = message.seq / 100.0
        assert message.values[0] == pytest.approx(0.5 - age, abs=0.2)
        assert message.stops == 0
        assert unit.now() < 1.0
        later = unit.receive()
        assert later.seq > message.seq
        assert later.t_received > message.t_received


@on_time
def test_unread_measurements_never_block_the_unit():
    fast = make_unit("rod_pendulum", sensor={"rate_hz": 1000.0})
    with Unit(fast) as unit:
        unit.reset()
        time.sleep(0.8)  # more messages than the channel holds
        stamps = [unit.receive() for _ in range(20)]
        assert all(b.t_received > a.t_received for a, b in pairwise(stamps))
        newest = receive_until(unit, 0.9)
        assert newest.seq > 400


def test_killed_unit_is_one_clear_error():
    unit = Unit(SPEC)
    with unit:
        assert unit.pid is not None
        os.kill(unit.pid, signal.SIGKILL)
        with pytest.raises(UnitError, match=r'unit "unit" has died \(exit status -9\)'):
            drain(unit, 1.0)
        with pytest.raises(UnitError, match="has died"):
            unit.send(0.0)
    with pytest.raises(UnitError, match="not running"):
        unit.receive()


def test_frozen_unit_is_a_timeout():
    with Unit(SPEC) as unit:
        assert unit.pid is not None
        os.kill(unit.pid, signal.SIGSTOP)
        with pytest.raises(UnitError, match=r"no measurement within 0\.1 s"):
            drain(unit, 0.1)
        os.kill(unit.pid, signal.SIGCONT)


def test_process_ends_with_the_client():
    with Unit(SPEC) as unit:
        pid = unit.pid
        assert pid is not None
    assert gone(pid)


def test_process_ends_when_the_client_is_killed():
    client = (
        "import sys, time\n"
        "from deepkoco.unit import Unit, UnitSpec\n"
        "with Unit(UnitSpec.from_json(sys.argv[1])) as unit:\n"
        "    print(unit.pid, flush=True)\n"
        "    time.sleep(30)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", client, SPEC.to_json()], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        pid = int(process.stdout.readline())
        process.kill()
    deadline = time.monotonic() + 60.0
    while not gone(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert gone(pid)


def test_modules_of_the_working_folder_do_not_disturb_the_unit(tmp_path, monkeypatch):
    (tmp_path / "select.py").write_text("raise RuntimeError('wrong module')")
    monkeypatch.chdir(tmp_path)
    with Unit(SPEC) as unit:
        assert unit.reset().seq <= 20


def test_orders_on_the_channel_that_are_not_finite_stop_the_unit():
    with Unit(SPEC) as unit:
        unit.reset((0.3, 0.0))
        unit.send(1.0)
        frames = [(Order.COMMAND, math.nan, 0.0), (Order.RESET, math.nan, 0.0), (Order.RESET, 0.0, math.inf)]
        for order, first, second in frames:  # as a client of another make may send them
            unit._commands.sendall(COMMAND_FRAME.pack(order, 1, first, second))
        message = receive_until(unit, 0.2)
        assert message.stops == 3
        assert all(math.isfinite(value) for value in message.values)


def test_commands_and_states_must_be_finite():
    with Unit(SPEC) as unit:
        with pytest.raises(ValueError, match="nan is not finite"):
            unit.send(math.nan)
        with pytest.raises(ValueError, match="not finite"):
            unit.reset((math.inf, 0.0))
