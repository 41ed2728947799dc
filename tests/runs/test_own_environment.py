"""A task of the user's own: found by MODULE:ID, trained, evaluated and shown, from any folder."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium
import pytest
import yaml

from deepkoco.analysis.measures import view
from deepkoco.analysis.page import analyse
from deepkoco.cli.command_line import main
from deepkoco.envs.task_factory import TaskConfig, TaskError, make_task_factory
from deepkoco.envs.task_files import TASK_FILES
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.model_yaml import save_model

MODULE = Path(__file__).with_name("my_cart.py")
FEW = [
    "agent.model.encoder_hidden=[8]", "agent.model.cost_hidden=[8]", "agent.model.pairs=2",
    "agent.first_episodes=4", "agent.first_epochs=2", "agent.iteration_episodes=2", "agent.total_episodes=6",
    "agent.evaluation_episodes=2", "agent.final_evaluation_episodes=3",
]  # fmt: skip


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """A current folder with the user's module in it, which Python has not seen yet."""
    shutil.copy(MODULE, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    yield tmp_path
    sys.modules.pop("my_cart", None)
    gymnasium.registry.pop("Cart-v0", None)


@pytest.fixture
def extended_model(tmp_path) -> Path:
    """A model.yaml of another mass."""
    path = tmp_path / "report" / "model.yaml"
    path.parent.mkdir()
    save_model(path, ExtendedSystem(make_system("rod_pendulum"), (), {"mass": 1.5}))
    return path


def train(*settings: str) -> int:
    return main(["train", *FEW, *settings])


def test_a_module_of_the_current_folder_registers_the_task(here):
    make = make_task_factory(TaskConfig("cart", "my_cart:Cart-v0", kwargs={"mass": 2.0}))
    envs = make(3, 0)
    assert envs.num_envs == 3
    assert envs.envs[0].unwrapped.mass == 2.0  # pyright: ignore[reportAttributeAccessIssue]
    envs.close()


@pytest.mark.parametrize(
    ("task_id", "words"),
    [
        ("my_crt:Cart-v0", "there is no module my_crt, neither in "),
        ("my_cart:Car-v0", "the module my_cart is imported, but it registers no Car-v0"),
        ("Crt-v0", "for an environment of your own give MODULE:Crt-v0"),
        ("broken:Cart-v0", "importing broken failed: ZeroDivisionError"),
        ("needy:Cart-v0", "needy needs a module that is missing: No module named 'no_such_thing'"),
    ],
)
def test_an_id_that_is_not_found_says_why(here, task_id, words):
    Path("broken.py").write_text("1 / 0\n")
    Path("needy.py").write_text("import no_such_thing\n")
    with pytest.raises(TaskError) as error:
        make_task_factory(TaskConfig("cart", task_id))
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_the_installed_command_looks_into_the_current_folder(here):
    """`deepkoco` has the folder of the command on its path, not the current one."""
    code = (
        "import sys; sys.path = [p for p in sys.path if p]; from deepkoco.cli.command_line import main; "
        "raise SystemExit(main(['train', 'task=gymnasium', 'task.id=my_cart:Crt-v0', 'run=run']))"
    )
    ended = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert "the module my_cart is imported, but it registers no Crt-v0" in ended.stderr


@pytest.mark.study
def test_a_task_that_cannot_be_drawn_is_trained_evaluated_and_shown(here, capsys, monkeypatch):
    few = {"episodes": 2, "exploring_episodes": 4, "windows": 20, "prunings": 1, "film_plans": 1}
    whole = analyse.AnalysisOptions
    monkeypatch.setattr(analyse, "AnalysisOptions", lambda **given: replace(whole(**given), **few))
    monkeypatch.setattr(view, "GRID", 21)
    assert train("task=gymnasium", "task.id=my_cart:Cart-v0", "run=run") == 0
    assert main(["evaluate", "run", "episodes=2", "json=true"]) == 0
    evaluated = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert evaluated["n"] == 2
    assert evaluated["upright"] is None  # a cart on a line has no up
    assert main(["evaluate", "run", "episodes=2"]) == 0
    assert "upright" not in capsys.readouterr().out
    assert main(["show", "run", "--json"]) == 0
    left_out = json.loads(capsys.readouterr().out)["left_out"]
    assert left_out == ["The film of the plan: the environment cannot be drawn: it has no render()."]


def test_a_run_is_used_from_another_folder_and_after_its_model_is_gone(
    here, extended_model, capsys, monkeypatch
):
    settings = [
        "task.id=deepkoco/RodPendulumDelay-v0", "+task.kwargs.max_episode_steps=30",
        "+task.kwargs.model=report/model.yaml", "run=run",
    ]  # fmt: skip
    assert train(*settings) == 0
    assert train(*settings, "existing=resume") == 0
    assert "run: finished already" in capsys.readouterr().out

    def evaluated() -> float:
        assert main(["evaluate", f"run={here / 'run'}", "episodes=3", "json=true"]) == 0
        return json.loads(capsys.readouterr().out.splitlines()[-1])["mean"]

    cost = evaluated()
    elsewhere = here / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert evaluated() == cost
    extended_model.unlink()
    assert evaluated() == cost
    copy = here / "run" / TASK_FILES / "model" / "model.yaml"
    assert yaml.safe_load(copy.read_text())["parameters"]["mass"]["value"] == 1.5
    copy.unlink()
    assert main(["evaluate", f"run={here / 'run'}"]) == 2
    assert f"{extended_model}: cannot be read: No such file or directory" in capsys.readouterr().err


def test_a_relative_path_that_leads_nowhere_is_explained(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    task = TaskConfig("rod", "deepkoco/RodPendulumDelay-v0", kwargs={"model": "report/model.yaml"})
    with pytest.raises(TaskError) as error:
        make_task_factory(task)
    assert "report/model.yaml: cannot be read: No such file" in str(error.value)
    assert f"is not below the current folder, {tmp_path}" in str(error.value)


def test_a_sweep_is_gone_on_with_by_the_same_command_and_averaged(here, capsys):
    sweep = ["sweep", *FEW, "task=gymnasium", "task.id=my_cart:Cart-v0", "run=runs/seed_${seed}"]
    assert main([*sweep, "seed=0"]) == 0
    assert main([*sweep, "seed=0,1"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("finished already") == 1
    assert "runs/seed_0: finished already" in printed
    assert main(["aggregate", "runs", "--out", "summary"]) == 0
    assert "gymnasium, distractors none  2" in capsys.readouterr().out
    assert main(["sweep", "seeds=0"]) == 2
    assert "did you mean seed?" in capsys.readouterr().err
