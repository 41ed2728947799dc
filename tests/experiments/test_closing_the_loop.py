"""The study of what naming a hidden effect is worth in control, without its trainings."""

import gymnasium
import numpy as np
import pandas as pd
import pytest

from deepkoco.envs.task_factory import TaskConfig, make_task_factory
from deepkoco.envs.unit_env import UnitEnv
from deepkoco.runs.settings import ExperimentError
from deepkoco.systems import ExtendedSystem, load_model, make_system, save_model
from deepkoco.unit import load_unit
from experiments.closing_the_loop.__main__ import collected, main
from experiments.closing_the_loop.hidden import EFFECTS, NOTHING, SYSTEM, Case, cases
from experiments.closing_the_loop.steps import evaluate, refusal, run_folder, training_command, write_once
from experiments.closing_the_loop.summary import READING, as_table, summarise, write_results


def episodes(costs: dict[tuple[str, int], list[float]], case: str = "gain_strong") -> pd.DataFrame:
    rows = [
        {
            "case": case,
            "arm": arm,
            "seed": seed,
            "clock": "simulated",
            "episode": i,
            "cost": cost,
            "upright": cost < 500,
        }
        for (arm, seed), values in costs.items()
        for i, cost in enumerate(values)
    ]
    return pd.DataFrame(rows).assign(overruns=0, upright=True)


def test_savings_are_paired_by_seed_and_start_state():
    # Start states differ by hundreds; each policy of the extended simulator is 10 better on every one of them.
    table = summarise(
        episodes(
            {
                ("baseline", 0): [100.0, 900.0, 500.0],
                ("baseline", 1): [200.0, 800.0, 400.0],
                ("extended", 0): [90.0, 890.0, 490.0],
                ("extended", 1): [190.0, 790.0, 390.0],
            }
        )
    ).set_index("arm")
    row = table.loc["extended"]
    assert row["saved"] == pytest.approx(10.0)
    assert row["saved_low"] == pytest.approx(10.0)
    assert row["saved_high"] == pytest.approx(10.0)
    assert row["low"] < row["cost"] - 50.0 < row["cost"] + 50.0 < row["high"]
    assert np.isnan(table.loc["baseline", "saved"])


def test_a_seed_without_a_partner_is_left_out_of_the_difference():
    table = summarise(
        episodes({("baseline", 0): [100.0], ("extended", 0): [70.0], ("extended", 1): [900.0]})
    ).set_index("arm")
    assert table.loc["extended", "saved"] == pytest.approx(30.0)
    assert table.loc["extended", "seeds"] == 2


def test_the_table_tells_what_was_hidden_and_what_it_cost():
    summary = summarise(episodes({("baseline", 0): [600.0, 620.0], ("extended", 0): [200.0, 220.0]}))
    found = pd.DataFrame([{"case": "gain_strong", "hidden": "gain.factor 0.5", "named": "gain.factor 0.49"}])
    line = as_table(summary, found).splitlines()[-1]
    assert line.startswith("| gain.factor 0.5 | gain.factor 0.49 | 610 [")
    assert line.endswith("| 400 [400, 400] |")


def test_results_are_written_again_without_losing_what_was_said_about_them(tmp_path):
    (tmp_path / "study.json").write_text('{"training_episodes": 400}')
    table = episodes({("baseline", 0): [600.0, 620.0], ("extended", 0): [200.0, 220.0]})
    out = tmp_path / "out"
    write_results(out, tmp_path, [], table)
    readme = out / "README.md"
    assert "67 minutes" in readme.read_text().replace("\n", " ")
    said = f"{READING}\n\nFeedback makes up for the rest.\n"
    readme.write_text(readme.read_text() + said)
    write_results(out, tmp_path, [], table)
    assert readme.read_text().endswith(said)
    assert readme.read_text().count(READING) == 1
    assert {p.name for p in out.iterdir()} == {
        *("README.md", "PROVENANCE.md", "closing_the_loop.png"),
        *("episodes.csv", "summary.csv", "findings.csv"),
    }


def test_strong_units_come_first_and_each_has_a_unit_file(tmp_path):
    units = cases([NOTHING, *EFFECTS], ["weak", "strong"])
    assert [u.strength for u in units] == ["", *["strong"] * len(EFFECTS), *["weak"] * len(EFFECTS)]
    for unit in units:
        path = tmp_path / f"{unit.name}.yaml"
        path.write_text(unit.unit_file())
        spec = load_unit(path)
        assert spec.system == SYSTEM
        assert dict(spec.effects.get(unit.effect, {})).items() >= dict(unit.hidden).items()


def test_every_arm_trains_where_it_should(tmp_path):
    case = Case("payload", "strong")
    where = {
        arm: training_command(tmp_path, case, arm, 3, 400)
        for arm in ("baseline", "refit", "extended", "unit")
    }
    assert not any("model=" in word for word in where["baseline"])
    assert f"+task.kwargs.model={tmp_path / case.name / 'refit.yaml'}" in where["refit"]
    assert f"+task.kwargs.model={tmp_path / case.name / 'diagnosis' / 'model.yaml'}" in where["extended"]
    assert f"+task.kwargs.unit={tmp_path / case.name / 'unit.yaml'}" in where["unit"]
    assert "+task.kwargs.clock=simulated" in where["unit"]
    assert all("seed=3" in words and "existing=resume" in words for words in where.values())
    other = Case("gain", "weak")
    assert run_folder(tmp_path, case, "baseline", 3) == run_folder(tmp_path, other, "baseline", 3)
    assert run_folder(tmp_path, case, "extended", 3) != run_folder(tmp_path, other, "extended", 3)


def test_a_model_that_remembers_is_told_instead_of_trained(tmp_path):
    (tmp_path / "diagnosis").mkdir()
    model = ExtendedSystem(make_system(SYSTEM), ("backlash",), {"backlash.width": 0.1})
    save_model(tmp_path / "diagnosis" / "model.yaml", model)
    assert "remembers" in (refusal("extended", tmp_path) or "")
    save_model(tmp_path / "refit.yaml", ExtendedSystem(make_system(SYSTEM)))
    assert refusal("refit", tmp_path) is None
    assert refusal("unit", tmp_path) is None
    assert load_model(tmp_path / "refit.yaml").effects == ()


def test_trials_are_run_once_and_counted(make_run, tmp_path):
    case = Case("torque_bias", "weak")
    make_run(run_folder(tmp_path, case, "baseline", 0))
    (tmp_path / case.name).mkdir(exist_ok=True)
    write_once(tmp_path / case.name / "unit.yaml", case.unit_file())
    first = evaluate(tmp_path, case, "baseline", 0, 1, "simulated")
    path = tmp_path / case.name / "trials" / "baseline_seed_0_simulated.csv"
    before = path.stat().st_mtime_ns
    pd.testing.assert_frame_equal(first, evaluate(tmp_path, case, "baseline", 0, 1, "simulated"))
    assert path.stat().st_mtime_ns == before
    with pytest.raises(ExperimentError, match="holds 1 episodes, not 2"):
        evaluate(tmp_path, case, "baseline", 0, 2, "simulated")


def test_a_folder_of_another_study_is_refused(tmp_path, capsys):
    (tmp_path / "study.json").write_text('{"training_episodes": 7}\n')
    given = ["--runs", str(tmp_path), "--out", str(tmp_path / "out"), "--effects", "gain"]
    assert main(given) == 1
    assert "another --runs" in capsys.readouterr().err


def test_a_study_without_trials_is_an_empty_table(tmp_path):
    table = collected(tmp_path)
    assert table.empty
    assert {"case", "arm", "seed", "cost"} <= set(table.columns)


def test_an_agent_can_train_on_a_unit_in_virtual_time(tmp_path):
    path = tmp_path / "unit.yaml"
    path.write_text(Case("gain", "strong").unit_file())
    task = TaskConfig("unit", "deepkoco/Unit-v0", kwargs={"unit": str(path), "action_history": 2})
    vector = make_task_factory(task)(2, 0)
    seen, _ = vector.reset(seed=5)
    alone = UnitEnv(path, "simulated", action_history=2)
    first, _ = alone.reset(seed=5)
    np.testing.assert_array_equal(seen[0], first)
    assert not np.array_equal(seen[0], seen[1])
    rewards = vector.step(np.ones((2, 1), np.float32))[1]
    assert rewards[0] == pytest.approx(alone.step(np.ones(1))[1])
    vector.close()
    with pytest.raises(gymnasium.error.NameNotFound):
        gymnasium.make("deepkoco/NoUnit-v0")
