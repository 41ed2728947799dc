"""`deepkoco train --system my_robot.py:CLASS --task my_task.py:CLASS`: trained, evaluated, kept in the run."""

import json
import shutil
import sys
from pathlib import Path

import pytest

from deepkoco.cli.command_line import main
from deepkoco.systems import ExtendedSystem, load_system, save_model

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
FEW = [
    "agent.model.encoder_hidden=[8]", "agent.model.cost_hidden=[8]", "agent.model.pairs=2",
    "agent.first_episodes=4", "agent.first_epochs=2", "agent.iteration_episodes=2", "agent.total_episodes=6",
    "agent.evaluation_episodes=2", "agent.final_evaluation_episodes=3",
]  # fmt: skip
TASK = """
import torch
from deepkoco import Task

class Swing(Task):
    limits = {"cart": (-20.0, 20.0)}
    control_rate = 25.0
    def cost(self, scene, state, commands, parameters=None):
        return state[..., 0] ** 2 + 1.0 + torch.cos(state[..., 1])
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder with a robot and a task."""
    shutil.copy(EXAMPLES / "cart_pole.py", tmp_path / "my_robot.py")
    (tmp_path / "my_task.py").write_text(TASK)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    return tmp_path


def evaluated(run: Path, capsys) -> float:
    capsys.readouterr()
    assert main(["evaluate", f"run={run}", "episodes=3", "json=true"]) == 0
    return json.loads(capsys.readouterr().out.splitlines()[-1])["mean"]


def test_a_robot_and_a_task_are_trained_and_evaluated_also_after_their_files_are_gone(
    here, capsys, monkeypatch
):
    (here / "report").mkdir()
    model = here / "report" / "model.yaml"
    save_model(model, ExtendedSystem(load_system("my_robot.py:CartPole"), (), {"pole_mass": 0.35}))
    assert main(["train", "--system", "report/model.yaml", "--task=my_task.py:Swing", *FEW, "run=run"]) == 0
    cost = evaluated(here / "run", capsys)
    config = (here / "run" / "config.yaml").read_text()
    assert "time_step: 0.04" in config
    assert "name: cart_pole" in config
    for gone in ("my_robot.py", "my_task.py", "report"):
        (here / gone).rename(here / f"{gone}_away")
    (here / "elsewhere").mkdir()
    monkeypatch.chdir(here / "elsewhere")
    assert evaluated(here / "run", capsys) == cost


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--system", "my_robt.py:CartPole"], "there is no file my_robt.py"),
        (["--system", "my_robot.py:CartPole", "--task", "my_task.py:Swimg"], "did you mean Swing?"),
        (["--task", "my_task.py:Swing"], "give --system too"),
        (["--system="], "--system: give a value"),
        (["--system", "my_robot.py", "task=pendulum"], "give only one of them"),
    ],
)
def test_wrong_robots_and_tasks_end_with_one_line(here, capsys, arguments, said):
    assert main(["train", *arguments, *FEW, "run=run"]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (here / "run").exists()
