"""What the experiment commands say to arguments of the wrong form."""

import sys

import pytest

from deepkoco.runs.hydra_command import run_command


def refusal(monkeypatch, capsys, command, *arguments):
    monkeypatch.setattr(sys, "argv", [command, *arguments])
    with pytest.raises(SystemExit) as stop:
        run_command(command, lambda config: pytest.fail("ran"))
    assert stop.value.code == 2
    return capsys.readouterr().err


def test_a_bare_folder_is_answered_with_the_form_of_a_setting(monkeypatch, capsys):
    text = refusal(monkeypatch, capsys, "evaluate", "runs/first")
    assert text == "error: runs/first: settings are given as NAME=VALUE, such as run=runs/first\n"


@pytest.mark.parametrize(
    ("command", "arguments", "name"), [("evaluate", [], "run"), ("train", ["task=gymnasium"], "task.id")]
)
def test_a_setting_without_a_default_is_asked_for_by_name(monkeypatch, capsys, command, arguments, name):
    text = refusal(monkeypatch, capsys, command, *arguments)
    assert text == f"error: {name} is not given; add {name}=VALUE\n"


@pytest.mark.parametrize("argument", ["task=pendulums", "agent=deepkoco,dcb", "+ablation=rank"])
def test_a_mistyped_file_is_answered_with_those_there_are(monkeypatch, capsys, argument):
    text = refusal(monkeypatch, capsys, "train", argument)
    group, chosen = argument.lstrip("+").split("=")
    wrong = chosen.split(",")[-1]
    assert text.startswith(f"error: {group}={wrong}: no such file in configs/{group}; choose from ")
    assert text.count("\n") == 1
