"""The study of interactive imitation: settings, rows, tables, curves, film."""

import json

import numpy as np
import pytest
import torch

from baselines.imitation.teachers.function import FunctionTeacher
from experiments.studies.learning import imitation_clock, imitation_film, imitation_runs, imitation_study


def run(task, method, seed, points, teacher=(100.0, 50.0)):
    curve = [{"queries": q, "steps": 10 * q, "cost": c, "doubt": 0.1} for q, c in points]
    about = {"task": task, "method": method, "seed": seed, "commit": "abc", "cpu_seconds": 7.0}
    return {**about, "teacher": dict(zip(("way", "end"), teacher, strict=True)), "curve": curve}


@pytest.fixture
def folder(tmp_path):
    runs = [
        run("pendulum", "random", 0, [(200, 400.0), (400, 105.0), (600, 60.0)]),
        run("pendulum", "random", 1, [(200, 400.0), (400, 120.0), (600, 54.0)]),
        run("pendulum", "doubt", 0, [(200, 400.0), (400, 200.0), (600, 80.0)]),
        run("pendulum", "doubt", 1, [(200, 400.0), (400, 200.0), (600, 54.0)]),
    ]
    for each in runs:
        name = f"{each['task']}_{each['method']}_{each['seed']}.json"
        (tmp_path / name).write_text(json.dumps(each))
    return tmp_path


@pytest.mark.parametrize("method", imitation_runs.METHODS)
def test_every_method_has_settings_and_a_colour(method):
    imitation_runs.make_config(method, "optimal").check()
    assert method in imitation_study.COLOURS


def test_costs_are_compared_with_the_teacher_from_the_same_start_states(folder):
    """The last evaluation has start states of its own, where the teacher costs 50 instead of 100."""
    runs, curves = imitation_study.tables(folder)
    random = runs[runs["method"] == "random"].set_index("seed")
    assert random["ratio"].tolist() == [1.2, 1.08]
    assert random["questions_to_1.1"].tolist() == [400, 600]
    assert random["questions_to_1.5"].tolist() == [400, 400]
    assert np.isinf(runs[(runs["method"] == "doubt") & (runs["seed"] == 0)]["questions_to_1.1"]).all()
    own = curves[(curves["method"] == "doubt") & (curves["seed"] == 0)]
    assert imitation_study.ratio_at(own, 300) == pytest.approx(3.0)
    assert np.isnan(imitation_study.ratio_at(own, 700))


def test_a_table_says_how_many_runs_reach_the_goal(folder):
    text = imitation_study.summary(*imitation_study.tables(folder))
    assert "| random questions | 400 (400 to 400), 2 of 2 | 500 (400 to 600), 2 of 2 | 3.71 [" in text
    assert "| most doubt | - (600 to -), 1 of 2 | - (600 to -), 1 of 2 |" in text
    assert len(imitation_study.draw(imitation_study.tables(folder)[1]).axes) == 1


def test_a_teacher_that_acts_has_its_own_cost(tmp_path):
    path = tmp_path / "teacher.py"
    path.write_text("def rest(observations):\n    return 0 * observations[:, :1]\n")
    task = imitation_runs.TASKS["pendulum"]
    config = imitation_runs.make_config("random", "optimal")
    config.evaluation_episodes, config.final_evaluation_episodes = 2, 3
    costs = imitation_runs.teacher_costs(task, FunctionTeacher(f"{path}:rest"), 0, config)
    assert 900 < costs["way"] < 2000  # hanging down costs pi^2 a step
    assert costs["way"] != costs["end"]


def test_a_task_without_its_teacher_is_named(tmp_path, capsys):
    assert imitation_study.main(["--out", str(tmp_path), "--tasks", "reacher"]) == 2
    assert "--reacher: give the folder of the trained run that teaches it" in capsys.readouterr().err


def test_a_film_marks_what_is_asked(monkeypatch, tmp_path):
    path = tmp_path / "teacher.py"
    path.write_text("def rest(observations):\n    return 0 * observations[:, :1]\n")
    monkeypatch.setattr(imitation_film, "make_teacher", lambda name: FunctionTeacher(f"{path}:rest"))
    frames = imitation_film.film((0, 1), updates=5, hidden=(8,), query_rate=0.3)
    assert [len(frames[number]) for number in (0, 1)] == [200, 200]
    colours = [tuple(frame[0, -1]) for frame in frames[0]]
    assert set(colours) == {imitation_film.ASKED}
    assert {tuple(frame[0, -1]) for frame in frames[1]} == {imitation_film.ASKED, imitation_film.QUIET}


def test_a_student_learns_in_a_graph_in_simulated_time():
    rows = imitation_clock.learn(False, 0, rounds=3)
    assert rows[0]["asked"] == imitation_clock.STEPS
    assert all(row["answered"] <= row["asked"] for row in rows)
    assert rows[-1]["answers"] == sum(row["answered"] for row in rows)
    assert rows[-1]["error"] < rows[0]["error"]


def test_the_script_swings_up_and_holds():
    state, dt = np.array([3.0, 0.0]), 0.05
    for _ in range(200):
        seen = torch.tensor([[np.cos(state[0]), np.sin(state[0]), state[1]]])
        torque = float(imitation_clock.swing_up(seen))
        speed = state[1] + dt * (15.0 * np.sin(state[0]) + 3.0 * torque)  # Gymnasium's Pendulum-v1
        state = np.array([state[0] + dt * speed, speed])
    assert np.cos(state[0]) > 0.95
