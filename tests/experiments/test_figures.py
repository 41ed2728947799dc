"""Figures from folders of runs of several agents."""

import pandas as pd
import pytest
from omegaconf import OmegaConf

from deepkoco.envs.task_factory import TaskConfig
from deepkoco.runs.settings import ExperimentError
from experiments.comparison.references import COLUMNS
from experiments.comparison.runs import evaluations, find_runs, variants
from experiments.figures import main


def write(folder, make_run, costs=(300.0, 160.0), every=100, agent="deepkoco", **settings):
    """A run with a row of metrics after every so many episodes of 200 steps."""
    run = make_run(folder, total_episodes=every * len(costs), **settings)
    stored = OmegaConf.load(run / "config.yaml")
    if agent == "deepkoco":
        del stored.agent["name"]  # as in runs from before there was a choice
    OmegaConf.save(stored, run / "config.yaml")
    rows = [
        f"{every * k},{200 * every * k},{50 * k},{30.0 * k},{cost + 50},{cost},20.0,{cost},10"
        for k, cost in enumerate(costs, 1)
    ]
    header = (
        "episodes,steps,updates,seconds,train/cost,evaluation/cost,evaluation/cost_sd,evaluation/cost_median,"
        "evaluation/episodes"
    )
    (run / "metrics.csv").write_text("\n".join([header, *rows]) + "\n")
    return run


@pytest.fixture
def references(tmp_path):
    """An optimum of 100 and a random policy of 1200 on the pendulum."""
    folder = tmp_path / "references"
    folder.mkdir()
    rows = [(0, "evaluation", k, 100.0 + k - 0.5, 95.0, 1200.0) for k in range(2)]
    pd.DataFrame(rows, columns=list(COLUMNS)).to_csv(folder / "pendulum.csv", index=False)
    return folder


def call(out, *runs, references, figure="5.2", **options):
    given = [item for name, value in options.items() for item in (f"--{name}", *value)]
    return main(
        [*map(str, runs), "--figure", figure, "--out", str(out), "--references", str(references), *given]
    )


def test_a_figure_comes_with_what_it_draws_and_where_it_comes_from(make_run, tmp_path, references, capsys):
    for seed, cost in enumerate((110.0, 120.0, 130.0)):
        write(tmp_path / "clean" / f"seed_{seed}", make_run, (300.0, cost), seed=seed)
        write(tmp_path / "copies" / f"seed_{seed}", make_run, (900.0, 800.0), seed=seed, distractors="copies")
    out = tmp_path / "out"
    assert (
        call(out, tmp_path / "clean", tmp_path / "copies", references=references, targets=["1.25", "9"]) == 0
    )
    assert "100" in capsys.readouterr().out
    names = {"README.md", "PROVENANCE.md", "learning_curves.png"}
    names |= {f"{name}.csv" for name in ("curves", "raw", "final", "times", "efficiency", "settings")}
    assert {path.name for path in out.iterdir()} == names
    assert (out / "learning_curves.png").read_bytes()[1:4] == b"PNG"
    final = pd.read_csv(out / "final.csv").set_index("distractors")
    assert final.loc["none", ["n", "iqm", "optimum", "random"]].tolist() == [3, 120.0, 100.0, 1200.0]
    assert final.loc["copies", ["steps", "updates", "seconds"]].tolist() == [40_000, 100, 60.0]
    efficiency = pd.read_csv(out / "efficiency.csv").set_index(["distractors", "factor", "criterion"])
    assert efficiency.loc[("none", 1.25, "reached"), "arrived"] == 2
    assert efficiency.loc[("copies", 1.25, "reached"), "arrived"] == 0
    assert efficiency.loc[("copies", 9.0, "kept"), "episodes"] == 100.0
    raw = pd.read_csv(out / "raw.csv")
    assert len(raw) == 12
    assert raw["run"].str.startswith(("clean/", "copies/")).all()
    stored = pd.read_csv(out / "settings.csv").set_index(["distractors", "setting"])["value"]
    assert (stored["none", "agent.learning_rate"], stored["copies", "agent.model.pairs"]) == ("0.001", "10")
    page = (out / "README.md").read_text()
    assert "DeepKoCo 40,000 steps (200 episodes, 100 updates)" in page
    assert "No runs were given for: manipulator, clean; manipulator, distractors copies." in page
    assert "0 of 3" in page
    assert str(tmp_path) not in page
    assert call(out, tmp_path / "clean", references=references) == 2
    assert "exists already" in capsys.readouterr().err


def test_unfinished_runs_are_left_out_or_marked(make_run, tmp_path, references, caplog):
    runs = tmp_path / "runs"
    write(runs / "a", make_run, (200.0, 100.0))
    write(runs / "b", make_run, (200.0, 150.0), seed=1, finished=False)
    text = (runs / "b" / "metrics.csv").read_text().splitlines()
    (runs / "b" / "metrics.csv").write_text("\n".join(text[:-1]) + "\n")
    assert call(tmp_path / "one", runs, references=references) == 0
    assert "left out 1 runs" in caplog.text
    assert pd.read_csv(tmp_path / "one" / "final.csv")["n"].tolist() == [1]
    assert call(tmp_path / "two", runs, references=references, unfinished=[]) == 0
    final = pd.read_csv(tmp_path / "two" / "final.csv").iloc[0]
    assert (final["n"], final["unfinished"]) == (2, 1)
    page = (tmp_path / "two" / "README.md").read_text()
    assert "**Some runs are not finished.**" in page
    assert "2, 1 unfinished" in page


def test_runs_of_one_agent_with_other_settings_are_methods_of_their_own(make_run, tmp_path):
    write(tmp_path / "a", make_run)
    write(tmp_path / "b", make_run, horizon=20)
    write(tmp_path / "c", make_run, distractors="copies", horizon=12)
    found = find_runs([tmp_path, tmp_path / "a"], unfinished=False)
    assert [run.folder.name for run in found] == ["a", "b", "c"]
    # Alone in its panel, c has nothing to be told apart from.
    assert variants(found) == ["agent.horizon = 15", "agent.horizon = 20", ""]
    write(tmp_path / "d", make_run)
    with pytest.raises(ExperimentError, match=f"same settings and seed as {tmp_path / 'a'}"):
        evaluations(find_runs([tmp_path], unfinished=False))


def test_runs_collected_without_weights_are_finished_by_their_episodes(make_run, tmp_path, references):
    write(tmp_path / "runs" / "a", make_run, finished=False)
    assert call(tmp_path / "out", tmp_path / "runs", references=references) == 0


def test_a_task_with_other_arguments_has_no_optimum(make_run, tmp_path, references):
    kwargs = {"action_units": "physical", "max_episode_steps": 100}
    write(
        tmp_path / "runs" / "a",
        make_run,
        task=TaskConfig("pendulum", "deepkoco/RodPendulum-v0", kwargs=kwargs),
    )
    assert call(tmp_path / "out", tmp_path / "runs", references=references) == 0
    assert pd.read_csv(tmp_path / "out" / "final.csv")["optimum"].isna().all()
    assert "no optimum is stored" in (tmp_path / "out" / "README.md").read_text()


def test_what_cannot_be_drawn_is_said_in_one_line(make_run, tmp_path, references, capsys):
    runs = tmp_path / "runs"
    write(runs / "a", make_run)
    cases = {
        "no run of pendulum from images; there are runs of: pendulum, clean": {"figure": "5.3"},
        "no run of manipulator from states": {"tasks": ["manipulator"]},
        "--targets 0.5: give multiples": {"targets": ["0.5"]},
    }
    for text, options in cases.items():
        assert call(tmp_path / "out", runs, references=references, **options) == 2
        assert text in capsys.readouterr().err
    assert call(tmp_path / "out", tmp_path / "references", references=references) == 2
    assert "no run below it" in capsys.readouterr().err
    (runs / "a" / "metrics.csv").write_text("episodes,steps\n1,2\n")
    assert call(tmp_path / "out", runs, references=references) == 2
    assert "no column updates, seconds" in capsys.readouterr().err
    (references / "pendulum.csv").write_text("seed\n0\n")
    write(tmp_path / "more" / "a", make_run)
    assert call(tmp_path / "out", tmp_path / "more", references=references) == 2
    assert "pendulum.csv: not what experiments.reference_costs writes" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
