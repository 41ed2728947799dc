"""Studies of SAC on a unit: resumed run by run, never mixed with another study."""

import pandas as pd
import pytest

from deepkoco.runs.settings import ExperimentError
from experiments import delay_training, domain_randomization
from experiments.sac_on_unit import main, run_study

STUDY = delay_training.STUDY


@pytest.mark.bench
@pytest.mark.timeout(300)
def test_a_study_goes_on_where_it_stopped(tmp_path):
    pytest.importorskip("stable_baselines3", reason="needs the bench extra: make bench")
    out, lines = tmp_path / "study", []

    def run(conditions):
        return run_study(
            STUDY, out, [0], ["rod_pendulum"], conditions, steps=520, episodes=1, report=lines.append
        )

    run(["without delays"])
    first = (out / "runs" / "rod_pendulum-without_delays-0" / "evaluation.csv").stat()
    episodes = run(["without delays", "with delays"])
    assert (out / "runs" / "rod_pendulum-without_delays-0" / "evaluation.csv").stat() == first
    assert [("there already" in line) for line in lines] == [False, True, False]
    assert set(episodes["condition"]) == {"without delays", "with delays"}
    assert set(episodes["place"]) == {"simulator", "unit"}
    summary = pd.read_csv(out / "summary.csv")
    assert len(summary) == 4
    assert (summary["cost"] > 0).all()
    for name in ("episodes.csv", "PROVENANCE.md", "delay_training.png"):
        assert (out / name).stat().st_size > 0
    assert main(STUDY, "", ["--out", str(out), "--steps", "530"]) == 2  # other settings


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--systems", "lamp"], 'system "lamp" is none of rod_pendulum'),
        (["--conditions", "blind"], 'condition "blind" is none of without delays, with delays'),
        (["--steps", "10"], "--steps 10: give at least 501"),
    ],
)
def test_wrong_arguments_end_with_one_line(tmp_path, capsys, arguments, message):
    assert main(STUDY, "", ["--out", str(tmp_path / "new"), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_a_folder_that_holds_something_else_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ExperimentError, match="is not empty and holds no study"):
        run_study(STUDY, tmp_path, [0], ["rod_pendulum"], ["with delays"])


def test_the_units_lie_inside_the_ranges_that_agents_are_trained_with():
    study = domain_randomization.STUDY
    for system, bench in study.benches.items():
        for name, value in bench.unit["parameters"].items():
            low, high = domain_randomization.PARAMETERS[system][name]
            assert low <= value <= high
        for name, effect in bench.unit["effects"].items():
            low, high = domain_randomization.DELAYS[system][name]
            assert low <= effect["delay"]["mean"] <= high
