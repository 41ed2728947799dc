"""Performance against difficulty: every run at every intensity, once."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepkoco.runs.settings import ExperimentError, TaskConfig
from deepkoco.runs.train import load_run_config
from experiments.studies.learning import difficulty
from experiments.studies.learning.difficulty_figure import SAME, curves


@pytest.fixture
def runs(make_run, tmp_path) -> Path:
    """Two seeds of runs trained among copies at intensity 1, and one at 0.5."""
    for name, seed, intensity in (("a", 0, 1.0), ("b", 1, 1.0), ("c", 0, 0.5)):
        kwargs = {"action_units": "physical", "max_episode_steps": 30}
        task = TaskConfig("pendulum", "deepkoco/RodPendulum-v0", kwargs=kwargs)
        run = make_run(tmp_path / "runs" / name, task, distractors="copies", entries=15, seed=seed)
        text = (run / "config.yaml").read_text()
        changed = text.replace("intensity: 1.0", f"intensity: {intensity}", 1)
        (run / "config.yaml").write_text(changed)
        assert load_run_config(run).distractor_options.intensity == intensity
    return tmp_path / "runs"


def call(out: Path, runs: Path, *intensities: str, **options: str) -> int:
    return difficulty.main(
        ["--out", str(out), "--runs", str(runs), "--episodes", "2", "--intensities", *intensities]
    )


@pytest.mark.study
def test_a_stopped_command_goes_on_where_it_was(runs, tmp_path, monkeypatch):
    out = tmp_path / "out"
    assert call(out, runs, "0", "1") == 0
    first = pd.read_csv(out / "evaluations.csv")
    assert len(first) == 3 * 2
    assert set(first["trained_at"]) == {0.5, 1.0}
    assert first["method"].nunique() == 1
    assert (out / "difficulty.png").read_bytes()[1:4] == b"PNG"

    asked = []
    measure = difficulty.measure
    monkeypatch.setattr(
        difficulty, "measure", lambda config: asked.append(config.intensity) or measure(config)
    )
    assert call(out, runs, "0", "0.5", "1") == 0
    assert asked == [0.5] * 3
    both = pd.read_csv(out / "evaluations.csv")
    pd.testing.assert_frame_equal(both.iloc[:6], first)


def test_settings_of_the_command_itself_and_bad_numbers_are_refused(runs, tmp_path, capsys):
    assert call(tmp_path / "out", runs, "2") == 2
    assert "--intensities 2" in capsys.readouterr().err
    assert difficulty.main(["--out", str(tmp_path / "out"), "seed=3"]) == 2
    assert "seed=3" in capsys.readouterr().err
    with pytest.raises(ExperimentError, match="was trained on"):
        difficulty.evaluate_all([runs / "a"], tmp_path, "none", [0.0], 1)


def test_curves_by_hand():
    rows = [
        ("m", t, e, s, 10, 100.0 * t + 10.0 * e + 2.0 * s)
        for t in (0.0, 1.0)
        for e in (0.0, 1.0)
        for s in (0, 1)
    ]
    table = pd.DataFrame(rows, columns=["method", "trained_at", "evaluated_at", "seed", "n", "mean"])
    summary = curves(table, [0.0]).set_index(["curve", "intensity"])
    # Means of 2 seeds that differ by 2: t + e + 1, with half-width t(0.975, 1) 2^.5 / 2^.5 = 12.706.
    assert summary.loc[(SAME, 0.0), "mean"] == 1.0
    assert summary.loc[(SAME, 1.0), "mean"] == 111.0
    assert summary.loc[("trained at 0", 1.0), "mean"] == 11.0
    np.testing.assert_allclose(summary["high"] - summary["mean"], 12.706, atol=1e-3)
    assert ("trained at 1", 0.0) not in summary.index
