"""`deepkoco show RUN`: one page for a training run or a model."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

import deepkoco.analysis.page.analyse as analyse_module
from deepkoco.agent.stored_controller import StoredController, write_controller
from deepkoco.analysis.measures import view
from deepkoco.analysis.page.page import data_folder
from deepkoco.analysis.run_folder import RunFolderError, read_trained
from deepkoco.cli.command_line import main
from deepkoco.koopman import KoopmanModel, ModelConfig, export_model
from deepkoco.planning import PlannerConfig

TASK = {"name": "pendulum", "id": "deepkoco/RodPendulum-v0"}
KWARGS = {"action_units": "physical", "max_episode_steps": 20}


def controller(task: dict, entries: int = 3) -> StoredController:
    torch.manual_seed(5)
    model = export_model(KoopmanModel(entries, 1, ModelConfig(3, 0.05, (8, 8), (8,))))
    limit = np.array([2.0])
    return StoredController(model, PlannerConfig(horizon=6), -limit, limit, task, {"seed": 4})


@pytest.fixture
def run(tmp_path) -> Path:
    """The files of a finished run with distractors, without the training."""
    folder = tmp_path / "run"
    folder.mkdir()
    write_controller(controller({}, 15), folder / "model")
    settings = {
        "task": {**TASK, "kwargs": KWARGS},
        "agent": {"horizon": 7},
        "seed": 4,
        "distractors": "copies",
    }
    (folder / "config.yaml").write_text(json.dumps(settings))  # JSON is YAML
    row = {"episodes": 5, "train/cost": 9.0, "evaluation/cost": 8.0, "evaluation/episodes": 2, "seconds": 1.0,
           "loss/linear": 0.1}  # fmt: skip
    pd.DataFrame([row, {**row, "episodes": 9}]).to_csv(folder / "metrics.csv", index=False)
    history = {"episodes": [0, 5, 9]} | {
        f"{n}_{i}": [0.0, 1.0, 1.5] for n in ("mu", "omega") for i in (1, 2, 3)
    }
    pd.DataFrame(history).to_csv(folder / "eigenvalues.csv", index=False)
    return folder


@pytest.fixture
def small(monkeypatch) -> None:
    """Analyses of few episodes."""
    few = {"episodes": 2, "exploring_episodes": 4, "windows": 20, "prunings": 1, "film_plans": 1}
    whole = analyse_module.AnalysisOptions
    monkeypatch.setattr(view, "GRID", 21)
    monkeypatch.setattr(analyse_module, "AnalysisOptions", lambda **given: replace(whole(**given), **few))


@pytest.mark.study
@pytest.mark.usefixtures("small")
def test_a_run_becomes_one_page_with_its_data_beside_it(run, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert main(["show", str(run), "--out", str(page), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["left_out"] == []
    html = page.read_text()
    assert "http" not in html  # nothing is fetched
    tables = sorted(path.stem for path in data_folder(page).glob("*.csv"))
    # Saliency is that of images, and references are those of a finished training.
    assert tables == sorted({*analyse_module.ORDER, "plan"} - {"saliency", "references"})
    for name in tables:
        assert f"page_data/{name}.csv" in html
        assert len(pd.read_csv(data_folder(page) / f"{name}.csv")) > 0
    # Every picture and the film for a wide window and for a phone, all for light and for dark pages.
    assert html.count("<svg viewBox=") == 2 * (len(tables) - 1)
    assert html.count("data:video/webm") == 2
    assert "@media (prefers-color-scheme: dark)" in html
    for link in re.findall(r'<a href="([^"#]+)"', html):
        assert (page.parent / link).is_file()
    assert f"deepkoco export-model {run.as_posix()} --to onnx" in html
    assert "Made on " in html
    # The parts of the cost sum to all of it, the bars of the comparison are of the same episodes.
    assert pd.read_csv(data_folder(page) / "contribution.csv")["share"].sum() == pytest.approx(1.0, abs=1e-4)
    pruned = pd.read_csv(data_folder(page) / "pruning.csv")
    compared = pd.read_csv(data_folder(page) / "comparison.csv")
    assert pruned["closed_loop_cost"][0] == pytest.approx(compared["mean"][0], rel=1e-4)
    assert pd.read_csv(data_folder(page) / "sensitivity.csv")["belongs_to"].value_counts()["distractor"] == 12
    # Nothing is overwritten.
    before = page.read_bytes()
    assert main(["show", str(run), "--out", str(page)]) == 2
    assert "exists" in capsys.readouterr().err
    assert page.read_bytes() == before


@pytest.mark.usefixtures("small")
def test_a_model_folder_is_shown_on_the_task_that_is_named(tmp_path, capsys):
    write_controller(controller({}), tmp_path / "model")
    page = tmp_path / "page.html"
    arguments = ["show", str(tmp_path / "model"), "--out", str(page)]
    assert main(arguments) == 2
    assert "give --task" in capsys.readouterr().err
    assert main([*arguments, "--task", "Nope-v3"]) == 2
    assert "Nope-v3" in capsys.readouterr().err
    assert main([*arguments, "--task", "MountainCarContinuous-v0"]) == 2
    assert "the model takes observations (3,)" in capsys.readouterr().err
    assert not page.exists()


def test_the_task_of_a_run_and_of_a_model_is_read_with_its_distractors(run, tmp_path):
    trained = read_trained(run)
    assert trained.settings.distractors == "copies"
    assert trained.settings.task.kwargs == KWARGS
    assert trained.trained_horizon == 7
    task = {
        **TASK,
        "kwargs": KWARGS,
        "observation": "states",
        "distractors": "copies",
        "action_units": "physical",
    }
    write_controller(controller(task, 15), tmp_path / "given")
    given = read_trained(tmp_path / "given")
    assert given.settings == trained.settings
    assert given.trained_horizon is None


def test_a_folder_that_is_no_run_is_told_by_its_own_name(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert main(["show", str(tmp_path / "empty")]) == 2
    said = capsys.readouterr().err
    assert said.startswith(
        f"deepkoco show: {tmp_path / 'empty'}: no config.json; give the folder of a finished training run"
    )


def test_an_unfinished_run_and_damaged_settings_are_told(run, tmp_path):
    (run / "config.yaml").write_text("task: {id: [")
    with pytest.raises(RunFolderError, match="not the settings of a run"):
        read_trained(run)
    (run / "config.yaml").write_text("task: {id: Pendulum-v1}\nseed: many\n")
    with pytest.raises(RunFolderError, match="many"):
        read_trained(run)
    (run / "model").rename(tmp_path / "elsewhere")
    with pytest.raises(RunFolderError, match="not finished"):
        read_trained(run)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing"], "no such file or folder"),
        (["."], "no config.json"),
        ([".", "--pictures", "x"], "--pictures belongs to recordings"),
        ([".", "--from", "1", "--partial"], "--partial, --from belong to recordings"),
        (["file", "--out", "x.html"], "--out belongs to training runs"),
        ([".", "--out", "x.pdf"], "ends in .html"),
        ([".", "--seed", "-1"], "give 0 or more"),
    ],
)
def test_a_wrong_call_is_told_in_one_sentence(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    assert main(["show", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_inputs_that_do_not_exist_are_refused(run, capsys):
    assert main(["show", str(run), "--axes", "0", "15"]) == 2
    assert "inputs are 0 to 14" in capsys.readouterr().err
