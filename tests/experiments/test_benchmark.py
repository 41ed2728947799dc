"""A suite: its file, its sweeps, its scores worked out by hand, and a stopped one that is gone on with."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser

from deepkoco.envs.task_factory import TaskConfig
from deepkoco.runs.agents import register
from deepkoco.runs.configs import CONFIGS
from deepkoco.runs.settings import ExperimentError
from experiments.benchmark.__main__ import main
from experiments.benchmark.scores import method_scores, overall_scores, score
from experiments.benchmark.suite import SUITES, Cell, ScoreRange, cells, load_suite, read_arguments
from experiments.benchmark.sweeps import share, sweep_commands

MICRO = """
name: micro
agents:
  sac: [agent=sac, agent.hidden=8, agent.random_steps=30, agent.evaluation_every=1, agent.evaluation_episodes=1]
tasks: {gymnasium_pendulum: {zero_cost: 1250, full_cost: 145}}
among: [copies_5]
seeds: [0]
settings: [agent.total_episodes=3, agent.final_evaluation_episodes=2, agent.reference_episodes=0,
           +task.kwargs.max_episode_steps=20]
"""


def suite_of(*words: str):
    return load_suite(read_arguments(words))


@pytest.fixture
def micro(tmp_path) -> str:
    path = tmp_path / "micro.yaml"
    path.write_text(MICRO)
    return f"suite={path}"


def test_the_cells_come_seed_by_seed_and_can_be_chosen():
    suite = suite_of("suite=hour", "agents=[sac,deepmdp]", "among=[copies_5]", "seeds=[3,1]")
    assert list(cells(suite)) == [
        Cell(agent, "dm_cartpole_swingup", "copies_5", seed)
        for seed in (3, 1)
        for agent in ("sac", "deepmdp")
    ]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["suite=nope"], "no such suite; choose from full, hour, tiny"),
        (["tiny"], "given as NAME=VALUE, such as suite=tiny"),
        (["suite=tiny", "agent=sac"], "agent"),
        (["suite=tiny", "seeds=[x]"], "seeds"),
        (["suite=tiny", "seeds=[1,1]"], "give different ones"),
        (["suite=tiny", "agents=[ppo]"], r"agents=\[ppo\]: the suite has deepkoco, sac"),
        (["suite=tiny", "tasks=[]"], "tasks is empty"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_trained(words, message):
    with pytest.raises(ExperimentError, match=message):
        suite_of(*words)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (("full_cost: 145", "full_cost: 1250"), "are the same"),
        (("full_cost: 145", "fullcost: 145"), "fullcost"),
        (("[copies_5]", "[copies_6]"), "no copies_6 in configs/among; choose from acted_copies_20"),
        (("[agent=sac, ", "["), "the first of its settings is agent=NAME"),
    ],
)
def test_a_suite_of_ones_own_is_checked(tmp_path, changed, message):
    path = tmp_path / "own.yaml"
    path.write_text(MICRO.replace(*changed))
    with pytest.raises(ExperimentError, match=message):
        suite_of(f"suite={path}")


def test_bad_input_ends_with_one_line_and_status_2(capsys):
    assert main(["suite=nope"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("name", sorted(path.stem for path in SUITES.glob("*.yaml")))
def test_every_sweep_of_a_shipped_suite_is_made_of_settings_that_there_are(name, tmp_path):
    register()
    suite = suite_of(f"suite={name}")
    commands = list(sweep_commands(suite, tmp_path, "local"))
    assert len(commands) == len(suite.agents) * len(suite.among)
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        for k, (_, words, chosen) in enumerate(commands):
            read = OverridesParser.create().parse_overrides(words[3:])
            jobs = BasicSweeper.split_arguments(read, None)[0]
            assert len(jobs) == len(chosen) == len(suite.tasks) * len(suite.seeds)
            # All tasks once; of the other sweeps the first run.
            for job in jobs[: len(suite.tasks)] if k < len(suite.agents) else jobs[:1]:
                config = compose("train", [word for word in job if not word.startswith("hydra/")])
                assert Path(config.run) in {cell.folder(tmp_path) for cell in chosen}


def test_without_a_launcher_a_sweep_is_of_one_seed():
    seeds = [chosen[0].seed for _, _, chosen in sweep_commands(suite_of("suite=hour"), Path("out"), None)]
    assert seeds == [0] * 6 + [1] * 6


def test_a_score_is_on_the_line_through_its_two_costs():
    span = ScoreRange(250.0, 0.0)
    np.testing.assert_allclose(score(np.array([250.0, 0.0, 50.0, 300.0]), span), [0.0, 1000.0, 800.0, -200.0])


def rows(scores: dict[tuple[str, str, str], list[float]]) -> pd.DataFrame:
    of_all = {"finished": True, "cost": 1.0, "steps": 10, "updates": 5, "processor_seconds": 2.0}
    return pd.DataFrame(
        {"task": task, "among": among, "agent": agent, "seed": seed, "score": value, **of_all}
        for (task, among, agent), values in scores.items()
        for seed, value in enumerate(values)
    )


def test_means_and_losses_by_hand():
    """Of five seeds the interquartile mean leaves out one on each side: (2 + 3 + 4) / 3 = 3, and 6 alone."""
    table = method_scores(
        rows(
            {
                ("t", "none", "a"): [6.0] * 5,
                ("t", "copies_5", "a"): [1.0, 2.0, 3.0, 4.0, 90.0],
                ("t", "none", "b"): [-1.0, -3.0],
                ("t", "copies_5", "b"): [1.0, 3.0],
            }
        )
    ).set_index(["agent", "among"])
    assert table.loc[("a", "copies_5"), "score"] == pytest.approx(3.0)
    assert table.loc[("a", "copies_5"), "loss"] == pytest.approx(50.0)
    assert table.loc[("a", "copies_5"), "interval"] == "95 %"
    assert np.isnan(table.loc[("a", "none"), "loss"])
    assert table.loc[("b", "copies_5"), ["low", "high", "interval"]].tolist() == [1.0, 3.0, "range"]
    assert np.isnan(table.loc[("b", "copies_5"), "loss"])  # nothing is learned alone


def test_a_run_with_less_training_has_no_loss():
    table = rows({("t", "none", "a"): [6.0], ("t", "copies_5", "a"): [3.0]})
    cut = table.assign(finished=table["among"] == "none")
    losses = [method_scores(t).set_index("among")["loss"]["copies_5"] for t in (table, cut)]
    assert losses[0] == pytest.approx(50.0)
    assert np.isnan(losses[1])


def test_the_mean_over_tasks_is_of_agents_that_have_them_all():
    """Scores 1 2 3 4 of two tasks: without the lowest and the highest (2 + 3) / 2; no seed moves to another task."""
    table = overall_scores(
        rows({("t", "none", "a"): [1.0, 2.0], ("u", "none", "a"): [3.0, 4.0], ("t", "none", "b"): [9.0, 9.0]})
    )
    assert table["agent"].tolist() == ["a"]
    row = table.iloc[0]
    assert row["score"] == pytest.approx(2.5)
    # The lowest resample is 1 1 3 3, the highest 2 2 4 4.
    assert 2.0 <= row["low"] <= 2.5 <= row["high"] <= 3.0


def test_the_share_of_a_run_is_that_of_its_episodes(make_run, tmp_path):
    run = make_run(tmp_path / "run", finished=False, total_episodes=440)
    assert share(run) == pytest.approx(0.25)  # 110 of 440
    assert share(make_run(tmp_path / "done")) == 1.0
    assert share(tmp_path / "nothing") == 0.0


def test_a_suite_is_trained_tabulated_and_left_as_it_is_by_a_second_call(micro, tmp_path, capsys):
    out = tmp_path / "out"
    command = [micro, f"out={out}"]
    assert main(command) == 0
    scores = pd.read_csv(out / "scores.csv")
    assert scores[["task", "among", "agent", "seed", "finished", "steps", "updates"]].to_numpy().tolist() == [
        ["gymnasium_pendulum", "copies_5", "sac", 0, True, 60, 30]
    ]
    assert scores["score"][0] == pytest.approx(1000 * (1250 - scores["cost"][0]) / 1105, rel=1e-4)
    assert {"steps", "updates", "processor_seconds"} <= set(pd.read_csv(out / "curves.csv")["axis"])
    assert "1 of 1 runs are finished" in (out / "index.md").read_text()
    assert (out / "curves.png").stat().st_size > 1000
    said, before = capsys.readouterr(), {p: p.stat().st_mtime_ns for p in (out / "runs").rglob("*")}
    assert "1 of 1 runs" in said.err
    assert main(command) == 0
    assert {p: p.stat().st_mtime_ns for p in (out / "runs").rglob("*")} == before


def test_a_run_that_is_refused_is_named_with_its_reason(micro, make_run, tmp_path, capsys):
    task = TaskConfig("gymnasium_pendulum", "Pendulum-v1")
    cell = Cell("sac", "gymnasium_pendulum", "copies_5", 0)
    make_run(cell.folder(tmp_path / "out"), task, finished=False)  # other settings than those of the suite
    assert main([micro, f"out={tmp_path / 'out'}"]) != 0
    said = capsys.readouterr().err
    assert "sac, copies_5: status 2" in said
    assert "holds a run with" in said


@pytest.mark.study
@pytest.mark.long
@pytest.mark.timeout(600)  # nine processes one after the other, each of which imports everything
def test_killed_and_gone_on_with_equals_uninterrupted(tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert main(["suite=tiny", f"out={whole}"]) == 0
    command = [sys.executable, "-m", "experiments.benchmark", "suite=tiny", f"out={killed}"]
    process = subprocess.Popen(command, start_new_session=True)
    metrics = killed / "runs" / "sac" / "gymnasium_pendulum" / "none" / "seed_0" / "metrics.csv"
    while process.poll() is None and not metrics.exists():
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    shutil.copytree(killed, tmp_path / "at_the_kill")
    assert main(["suite=tiny", f"out={killed}"]) == 0
    tables = [
        pd.read_csv(f / "scores.csv").drop(columns=["seconds", "processor_seconds"]) for f in (whole, killed)
    ]
    pd.testing.assert_frame_equal(*tables, check_exact=True)
    models = [sorted((f / "runs").rglob("model.safetensors")) for f in (whole, killed)]
    assert [m.read_bytes() for m in models[0]] == [m.read_bytes() for m in models[1]]
    assert len(models[0]) == 4
