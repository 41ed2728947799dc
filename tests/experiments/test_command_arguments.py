"""What the experiment commands say to arguments of the wrong form."""

import runpy
import sys

import pytest

from deepkoco.runs import agents
from deepkoco.runs.agents import AgentKind
from deepkoco.runs.hydra_command import run_command
from deepkoco.runs.setting_names import check_names


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


@pytest.mark.parametrize(
    ("command", "arguments", "meant"),
    [
        ("train", ["agent.total_epsodes=3"], "agent.total_episodes"),
        ("train", ["-m", "seed=0,1", "distractor=none"], "distractors"),
        ("train", ["agent=dbc", "agent.learning_rat=1"], "agent.learning_rate"),
        ("train", ["agent.planner.horizn=3"], "agent.planner.horizon"),
        ("evaluate", ["run=x", "episode=3"], "episodes"),
    ],
)
def test_a_mistyped_setting_is_answered_with_the_nearest(monkeypatch, capsys, command, arguments, meant):
    wrong = arguments[-1].split("=")[0]
    text = refusal(monkeypatch, capsys, command, *arguments)
    assert text.startswith(f"error: {wrong}: there is no such setting; did you mean {meant}")
    assert text.count("\n") == 1


def test_settings_that_hydra_judges_are_left_alone():
    check_names(
        "train",
        [
            *("+task.kwargs.modl=x", "task.kwargs.tsk=hard", "~seed"),
            *("-m", "hydra.launcher.n_jobs=2", "task.kwargs=null", "zzz=1"),
        ],
    )


def test_an_agent_whose_package_is_missing_is_named(monkeypatch, capsys):
    kind = AgentKind("no_such_package.config:Settings", "no_such_package:Trainer", "no_such_package:load")
    monkeypatch.setitem(agents.AGENTS, "dbc", kind)
    text = refusal(monkeypatch, capsys, "train", "agent=dbc")
    assert text.startswith('error: agent = "dbc": its package "no_such_package" is not installed')
    assert "deepkoco, sac, sac_shared, deepmdp, ppo, imitation\n" in text


@pytest.mark.parametrize("name", ["train", "evaluate", "aggregate", "unit_trials"])
def test_the_modules_that_recorded_results_name_still_run(monkeypatch, capsys, name):
    monkeypatch.setattr(
        sys, "argv", [name, "nothing", "--unit", "nothing"][: 4 if name == "unit_trials" else 2]
    )
    with pytest.raises(SystemExit) as stop:
        runpy.run_module(f"experiments.{name}", run_name="__main__")
    assert stop.value.code == 2
    assert "nothing: " in capsys.readouterr().err


@pytest.mark.parametrize("argument", ["task=pendulums", "agent=deepkoco,dcb", "+ablation=rank"])
def test_a_mistyped_file_is_answered_with_those_there_are(monkeypatch, capsys, argument):
    text = refusal(monkeypatch, capsys, "train", argument)
    group, chosen = argument.lstrip("+").split("=")
    wrong = chosen.split(",")[-1]
    assert text.startswith(f"error: {group}={wrong}: no such file in configs/{group}; choose from ")
    assert text.count("\n") == 1
