"""The command line: help, exit statuses, one line per mistake, nothing overwritten."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from deepkoco.cli.command_line import main
from deepkoco.graph.episodes.storage import EpisodeWriter
from deepkoco.logs.recording import read_log
from tests.full_disk import largest_file
from tests.graph.episodes.test_episode_writer import GRAPH

UNIT = "system: rod_pendulum\neffects: {coulomb: {torque: 0.1}}\n"


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    path = tmp_path / "UNIT.yaml"
    path.write_text(UNIT)
    return path


def files(folder: Path) -> set[str]:
    return {p.name for p in folder.iterdir()}


def simulate(unit: Path, out: Path, *more: str) -> int:
    return main(["record", "--unit", str(unit), "--seconds", "2", "--simulated", "--out", str(out), *more])


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from deepkoco.cli.command_line import main\n"
        "for words in (['--help'], ['record', '--help'], ['inspect', '--help'], ['systems', '--help']):\n"
        "    try: main(words)\n"
        "    except SystemExit as end: assert end.code == 0\n"
        "assert not {'torch', 'pandas', 'numpy', 'rich'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for word in ("record", "inspect", "diagnose", "systems", "--excitation", "--json", "example"):
        assert word in done.stdout


def test_record_then_inspect(unit, tmp_path, capsys):
    assert simulate(unit, tmp_path / "log.csv", "--excitation", "prbs", "--rate", "25") == 0
    recording = read_log(tmp_path / "log.csv", system="rod_pendulum")
    assert len(recording.channels["theta"]) == 201
    assert len(recording.channels["torque"]) == 51
    assert "theta" in capsys.readouterr().out
    assert main(["inspect", str(tmp_path / "log.csv"), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    channels = {c["name"]: c for c in content["channels"]}
    assert content["system"] == "rod_pendulum"
    assert content["meta"]["excitation"] == "prbs"
    assert channels["theta"]["rate_hz"] == pytest.approx(100.0)
    assert channels["torque"]["unit"] == "N m"
    assert main(["inspect", str(tmp_path / "log.csv")]) == 0
    assert "100.0" in capsys.readouterr().out


def test_log_does_not_tell_what_is_hidden(unit, tmp_path):
    telling = unit.rename(tmp_path / "rod_pendulum_coulomb.yaml")
    assert simulate(telling, tmp_path / "log.csv") == 0
    text = (tmp_path / "log.csv").read_text() + (tmp_path / "log.yaml").read_text()
    assert "coulomb" not in text


def test_same_command_same_bytes(unit, tmp_path):
    assert simulate(unit, tmp_path / "a", "--seed", "3") == 0  # .csv is added
    assert simulate(unit, tmp_path / "b.csv", "--seed", "3") == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


@pytest.mark.parametrize(
    ("unit_text", "more", "parts"),
    [
        (UNIT, ["--system", "cartpole"], ["UNIT.yaml", "cartpole"]),
        (UNIT, ["--system", "pendulum"], ["UNIT.yaml", "rod_pendulum", "pendulum"]),
        (
            "system: rod_pendulum\neffects: {stiction: {torque: 1}}",
            [],
            ["UNIT.yaml", "effects", "stiction", "coulomb"],
        ),
        (UNIT, ["--amplitude", "5"], ["amplitude 5 N m", "2"]),
        (UNIT, ["--rate", "1000"], ["control rate 1000 Hz", "100 Hz"]),
        (UNIT, ["--seconds", "-3"], ["-3 s"]),
        (UNIT, ["--excitation", "policy"], ["--policy"]),
        (UNIT, ["--policy", "here"], ["--policy"]),
        (UNIT, ["--excitation", "policy", "--policy", "nowhere"], ["nowhere"]),
        (UNIT, ["--seed", "-1"], ["seed", "-1"]),
        (UNIT, ["--excitation", "policy", "--policy", "p", "--amplitude", "1"], ["--amplitude"]),
        (UNIT, ["--out", ""], ["--out", "is not a file name"]),
        (UNIT, ["--out", ".."], ["--out", "is not a file name"]),
        ("system: [a]", [], ["UNIT.yaml", "system", "a", "rod_pendulum"]),
    ],
)
def test_bad_input_is_one_line_and_status_2(tmp_path, capsys, unit_text, more, parts):
    unit = tmp_path / "UNIT.yaml"
    unit.write_text(unit_text)
    assert simulate(unit, tmp_path / "log.csv", *more) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith("deepkoco record: ")
    for part in parts:
        assert part in error
    assert files(tmp_path) == {"UNIT.yaml"}


@pytest.mark.parametrize("name", ["log.csv", "log.yaml"])
def test_existing_output_is_kept(unit, tmp_path, capsys, name):
    (tmp_path / name).write_text("mine")
    assert simulate(unit, tmp_path / "log.csv") == 2
    assert f"{name}: exists; choose another name" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "mine"
    assert files(tmp_path) == {"UNIT.yaml", name}


@pytest.mark.parametrize("more", [[], ["--rate", "1000"]])
def test_an_unwritable_place_is_told_before_recording(unit, tmp_path, capsys, more):
    """What is wrong with the recording itself comes later: the place is tried first."""
    (tmp_path / "afile").write_text("mine")
    assert simulate(unit, tmp_path / "afile" / "log.csv", *more) == 2
    error = capsys.readouterr().err
    assert "afile/log.csv: cannot be written" in error
    assert error.count("\n") == 1


def test_names_with_brackets_are_shown_as_they_are(unit, tmp_path, capsys):
    folder = tmp_path / "[red]x[" / "[/bold]"
    assert simulate(unit, folder / "a.csv") == 0
    assert main(["inspect", str(folder / "a.csv")]) == 0
    shown = "".join(capsys.readouterr().out.split())
    assert shown.count("[red]x[/[/bold]/a.csv") == 2
    text = (folder / "a.yaml").read_text()
    (folder / "a.yaml").write_text(text.replace("excitation: chirp", 'excitation: "[/blue] [green]chirp"'))
    assert main(["inspect", str(folder / "a.csv")]) == 0
    assert "[/blue][green]chirp" in "".join(capsys.readouterr().out.split())


def test_a_diagnosis_that_cannot_be_written_is_told_at_once(tmp_path, capsys):
    (tmp_path / "afile").write_text("mine")
    assert main(["diagnose", str(tmp_path / "none.csv"), "--out", str(tmp_path / "afile" / "x" / "y")]) == 2
    error = capsys.readouterr().err
    assert "afile is no folder" in error
    assert error.count("\n") == 1


def test_other_formats_are_refused_before_recording(unit, tmp_path, capsys):
    assert simulate(unit, tmp_path / "log.mcap") == 2
    assert "ends in .csv" in capsys.readouterr().err


def test_unit_that_stops_itself_is_status_1(tmp_path, capsys):
    unit = tmp_path / "UNIT.yaml"
    unit.write_text(
        "system: rod_pendulum\nheartbeat: 0.06\neffects: {sensing_delay: {delay: {mean: 0.15, sd: 0.1}}}\n"
    )
    assert simulate(unit, tmp_path / "log.csv") == 1
    error = capsys.readouterr().err
    assert error.startswith('deepkoco record: unit "UNIT" stopped itself')
    assert error.count("\n") == 1
    assert files(tmp_path) == {"UNIT.yaml"}


def test_inspect_of_a_missing_log(tmp_path, capsys):
    assert main(["inspect", str(tmp_path / "none.csv")]) == 2
    assert "none.csv: no such file" in capsys.readouterr().err


def test_the_arm_is_refused_where_one_joint_is_needed(tmp_path, capsys):
    (tmp_path / "UNIT.yaml").write_text("system: two_link_arm")
    assert main(["record", "--unit", str(tmp_path / "UNIT.yaml"), "--out", str(tmp_path / "a.csv")]) == 2
    error = capsys.readouterr().err
    assert "two_link_arm has 2 joints; this takes one that turns: choose one of pendulum" in error
    assert error.count("\n") == 1


def test_systems_shows_units_that_stand_in_brackets(capsys):
    motor = Path(__file__).parents[2] / "docs/examples/motor.py"
    assert main(["systems", f"{motor}:Motor"]) == 0
    said = capsys.readouterr().out
    assert "[Ohm]" in said
    assert "0.05 [0.005, 0.5] N m/A" in said


def test_systems_lists_names_units_and_bounds(capsys):
    assert main(["systems", "--json"]) == 0
    described = {s["name"]: s for s in json.loads(capsys.readouterr().out)}
    assert set(described) == {
        "double_pendulum", "furuta_pendulum", "pendulum", "quadrotor", "quadrotor_height", "rod_pendulum",
        "servo_pendulum", "torque_pendulum", "two_link_arm",
    }  # fmt: skip
    arm = [c["name"] for c in described["two_link_arm"]["channels"] if c["kind"] == "command"]
    assert arm == ["torque_1", "torque_2"]
    mass = next(p for p in described["rod_pendulum"]["parameters"] if p["name"] == "mass")
    assert (mass["value"], mass["unit"], mass["low"], mass["high"]) == (1.0, "kg", 0.1, 10.0)
    assert main(["systems", "rod_pendulum", "--effects"]) == 0
    assert "coulomb.torque" in capsys.readouterr().out
    assert main(["systems", "cartpole"]) == 2
    assert 'unknown system "cartpole"' in capsys.readouterr().err


def test_unknown_subcommand_is_status_2(capsys):
    with pytest.raises(SystemExit) as end:
        main(["recrod"])
    assert end.value.code == 2
    assert "recrod" in capsys.readouterr().err


def test_interrupt_after_the_log_is_written_does_not_deny_it(unit, tmp_path, capsys, monkeypatch):
    class Interrupting(io.StringIO):
        def write(self, text):
            raise KeyboardInterrupt

    monkeypatch.setattr(sys, "stdout", Interrupting())
    assert simulate(unit, tmp_path / "log.csv") == 130
    assert capsys.readouterr().err == "deepkoco record: interrupted\n"
    assert files(tmp_path) == {"UNIT.yaml", "log.csv", "log.yaml"}


def test_interrupted_recording_writes_nothing(unit, tmp_path):
    command = [
        sys.executable,
        "-m",
        "deepkoco.cli",
        "record",
        "--unit",
        str(unit),
        "--seconds",
        "60",
    ]
    process = subprocess.Popen(
        [*command, "--out", str(tmp_path / "log.csv")], stderr=subprocess.PIPE, text=True
    )
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    if not children.exists():
        process.kill()
        pytest.skip("needs /proc to see when the unit runs")
    deadline = time.monotonic() + 60.0
    while not (unit_pid := children.read_text().split()) and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=20.0)
    assert process.returncode == 130
    assert error == "deepkoco record: interrupted; nothing is written\n"
    assert files(tmp_path) == {"UNIT.yaml"}
    with pytest.raises(ProcessLookupError):
        os.kill(int(unit_pid[0]), 0)


@pytest.mark.parametrize("command", ["record", "inspect --plot", "inspect --out", "export", "show"])
def test_a_full_disk_ends_every_command_in_one_line_and_leaves_nothing(unit, tmp_path, capsys, command):
    logs, out = tmp_path / "logs", tmp_path / "out"
    logs.mkdir()
    out.mkdir()
    assert simulate(unit, logs / "a.csv") == 0
    _recording(logs / "a.mcap")
    (logs / "table.csv").write_bytes((logs / "a.csv").read_bytes())  # without a sidecar
    name, arguments = {
        "record": ("a.csv", ["record", "--unit", str(unit), "--seconds", "2", "--simulated", "--out"]),
        "inspect --plot": ("a.png", ["inspect", str(logs / "a.csv"), "--plot"]),
        "inspect --out": (
            "a.yaml",
            ["inspect", str(logs / "table.csv"), "--system", "rod_pendulum", "--out"],
        ),
        "export": ("a.csv", ["export", str(logs / "a.mcap")]),
        "show": ("pictures", ["show", str(logs / "a.mcap"), "--pictures"]),
    }[command]
    capsys.readouterr()
    with largest_file(300):
        status = main([*arguments, str(out / name)])
    error = capsys.readouterr().err
    assert status == 2
    assert error.startswith(f"deepkoco {command.split()[0]}: {out}")
    assert error.endswith(
        "cannot be written: file too large; raise the limit on the size of files (ulimit -f) or "
        "choose another disk\n"
    )
    assert error.count("\n") == 1
    assert not list(out.iterdir())


def _recording(path):
    with EpisodeWriter(path, GRAPH) as writer:
        for k in range(50):
            writer.step("world", k, k / 100, (k + 1) / 100, np.arange(3) + k)
            writer.step("agent", k, k / 50, k / 50, np.zeros(1))
