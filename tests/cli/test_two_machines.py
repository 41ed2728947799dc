"""`deepkoco serve`, `lead` and `merge`: what a user sees of them."""

import contextlib
import io
import os
import re
import signal
import socket
import threading
import time
from pathlib import Path

import pytest

from deepkoco.cli.command_line import main
from deepkoco.graph import read_episodes
from deepkoco.graph.net.graph_file import read_graph_file
from deepkoco.own_objects import OwnObjectError

EXAMPLE = str(Path(__file__).parents[2] / "docs/examples/two_machines.py")
CALM = ["--silence", "30000"]  # no test must end because a machine is busy


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return taken.getsockname()[1]


def test_the_example_of_the_page_runs_over_two_ends(tmp_path, capsys):
    address = f"127.0.0.1:{free_port()}"
    serve = ["serve", EXAMPLE, "--nodes", "world,sensor", "--threads", "world,sensor", "--listen", address]
    serve += [*CALM, "--sessions", "1", "--record", str(tmp_path / "robot")]
    thread = threading.Thread(target=main, args=(serve,), daemon=True)
    thread.start()
    until = time.monotonic() + 60.0
    while "waiting at" not in capsys.readouterr().out and time.monotonic() < until:
        time.sleep(0.05)
    record = tmp_path / "run.mcap"
    lead = [
        "lead",
        EXAMPLE,
        "--to",
        address,
        "--seconds",
        "0.3",
        "--episodes",
        "2",
        "--record",
        str(record),
        *CALM,
    ]
    assert main(lead) == 0
    thread.join(60.0)
    told = capsys.readouterr().out
    assert "leads" in told
    assert "session ended: it was told to" in told
    assert re.search(
        r"episode 1: 30 steps, \d+ overruns, 0 of \d+ messages lost, clocks known to 0\.\d+ ms", told
    )
    assert len(read_episodes(record).episodes) == 2
    merged = tmp_path / "merged.mcap"
    assert main(["merge", str(record), str(tmp_path / "robot/session_0000.mcap"), "--out", str(merged)]) == 0
    assert "2 episodes" in capsys.readouterr().out
    assert main(["merge", str(merged), str(record), "--out", str(tmp_path / "again.mcap")]) == 2
    assert "is merged already" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_serve_ends_in_order_when_it_is_told_to(capsys, name):
    number = getattr(signal, name, None)
    if number is None or signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip(f"{name} does not exist here, or is ignored")
    before = signal.getsignal(number)
    end = threading.Thread(target=_signal_once_waiting, args=(capsys, number))
    end.start()
    try:
        arguments = ["--nodes", "world,sensor", "--threads", "world,sensor", "--listen", "127.0.0.1:0"]
        assert main(["serve", EXAMPLE, *arguments]) == 0
    finally:
        end.join()
        signal.signal(number, before)


def _signal_once_waiting(capsys, number):
    until = time.monotonic() + 60.0
    while "waiting at" not in capsys.readouterr().out and time.monotonic() < until:
        time.sleep(0.05)
    os.kill(os.getpid(), number)


def refused(capsys, *arguments) -> str:
    assert main(list(arguments)) == 2
    return capsys.readouterr().err


def test_mistakes_are_one_line_that_says_what_to_do(tmp_path, capsys):
    serve = "serve", EXAMPLE, "--nodes", "world"
    assert "stays at the end that leads" in refused(capsys, "serve", EXAMPLE, "--nodes", "agent")
    assert "give more than 40 ms" in refused(capsys, *serve, "--silence", "30")
    assert "there is no file nowhere.py" in refused(capsys, "serve", "nowhere.py", "--nodes", "world")
    assert "give HOST:PORT" in refused(capsys, *serve, "--listen", "127.0.0.1:x")
    assert "cannot be made" in refused(capsys, *serve, "--record", f"{EXAMPLE}/robot")
    nobody = f"127.0.0.1:{free_port()}"
    assert "start `deepkoco serve` there" in refused(capsys, "lead", EXAMPLE, "--to", nobody)
    assert "no such file" in refused(capsys, "merge", "a.mcap", "b.mcap", "--out", str(tmp_path / "c.mcap"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("def graph():\n    return 3\n", r"graph\(\) returns a int; return a deepkoco\.graph\.Graph"),
        ("x = 1\n", "has no graph"),
    ],
)
def test_a_file_without_a_graph_is_refused(tmp_path, text, words):
    path = tmp_path / "robot.py"
    path.write_text(text)
    with pytest.raises(OwnObjectError, match=words):
        read_graph_file(str(path))


def test_a_file_needs_no_parameters():
    file = read_graph_file(EXAMPLE)
    assert set(file.parameters()) == {"world", "sensor"}
    with contextlib.redirect_stdout(io.StringIO()):
        assert file.factories({"world"})["world"]().name == "world"
