"""What the command line answers to mistyped commands, options and names."""

import pytest

from deepkoco.cli.command_line import COMMANDS, main
from deepkoco.suggestion import did_you_mean


def refused(capsys, *arguments: str) -> str:
    try:
        status = main(list(arguments))
    except SystemExit as stop:
        status = stop.code
    assert status == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["diagnose", "log.csv", "--systm", "pendulum"], "--system"),
        (["record", "--untt=unit.yaml", "--out", "log.csv"], "--unit"),  # a required option
        (["aggregate", "runs", "--outt", "x"], "--out"),
    ],
)
def test_a_mistyped_option_is_answered_with_the_usage_of_its_command(capsys, arguments, meant):
    told = refused(capsys, *arguments)
    assert told.startswith(f"usage: deepkoco {arguments[0]} ")
    assert told.rstrip().endswith(f"did you mean {meant}?")


def test_an_option_like_no_other_is_refused_without_a_proposal(capsys):
    told = refused(capsys, "aggregate", "runs", "--xyz")
    assert "there is no option --xyz; deepkoco aggregate --help lists them" in told


def test_a_mistyped_command_is_answered_with_the_nearest(capsys):
    assert 'there is no command "recrod"; did you mean record?' in refused(capsys, "recrod")


def test_a_mistyped_system_is_answered_with_the_nearest(capsys):
    told = refused(capsys, "systems", "rodpendulum")
    assert 'unknown system "rodpendulum"; did you mean rod_pendulum' in told


def test_abbreviated_options_are_still_taken(capsys):
    assert "none.csv: no such file" in refused(capsys, "inspect", "none.csv", "--js")


@pytest.mark.parametrize("name", ["train", "evaluate", "sweep", "aggregate"])
def test_commands_of_training_have_a_help_with_an_example(capsys, name):
    with pytest.raises(SystemExit) as stop:
        main([name, "--help"])
    assert stop.value.code == 0
    assert f"deepkoco {name} " in capsys.readouterr().out.split("example:")[1]
    assert name in COMMANDS


def test_names_are_compared_without_their_dashes_and_capitals():
    assert did_you_mean("Rod-Pendulum", ["rod_pendulum", "arm"]) == "; did you mean rod_pendulum?"
    assert did_you_mean("quad", ["rod_pendulum", "arm"]) == ""
