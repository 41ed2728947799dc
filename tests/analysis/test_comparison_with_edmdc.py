"""EDMDc fitted for comparison, and reference costs from a file."""

import numpy as np
import pytest

from deepkoco.analysis.measures.comparison import (
    ReferenceCostError,
    draw_comparison,
    episode_cost,
    fit_comparison,
    read_reference,
)
from deepkoco.analysis.measures.rollout import roll_out


def test_edmdc_finds_a_linear_system(exact):
    model, steps = exact
    linear = fit_comparison(steps, model.time_step, 0.0, np.random.default_rng(0))
    rollout = roll_out(linear, steps, steps.windows(5, 100, np.random.default_rng(0)), 5)
    spread = np.abs(rollout.encoded[..., :4]).max()
    # The first entries of the lifted observation are the observation itself.
    assert np.abs(rollout.latents - rollout.encoded)[..., :4].max() < 0.02 * spread


def test_reference_costs_are_read_and_shown(tmp_path):
    path = tmp_path / "reference.csv"
    path.write_text("name,mean,standard_error,episodes\noptimum,138.2,5.1,300\nMPC on the true model,141,,\n")
    reference = read_reference(path)
    assert reference["optimum"].mean == 138.2
    assert reference["optimum"].episodes == 300
    assert np.isnan(reference["MPC on the true model"].standard_error)
    own = {"DeepKoCo": episode_cost(np.array([100.0, 140.0]))}
    picture = draw_comparison({**own, **reference}, "fitted to nothing")
    assert picture.table["mean"].tolist() == [120.0, 138.2, 141.0]
    assert "reference values that were given" in picture.caption
    assert "No reference values" in draw_comparison(own, "fitted to nothing").caption


def test_the_table_of_the_optimum_is_a_file_of_reference_costs(tmp_path):
    path = tmp_path / "optimum.csv"
    path.write_text("method,input_delay,n,mean,standard_error\nvalue,False,50,138,5\nvalue,True,50,145,6\n")
    reference = read_reference(path)
    assert list(reference) == ["value", "value, one step of delay"]
    assert reference["value, one step of delay"].mean == 145
    assert reference["value"].episodes == 50


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("name,cost\na,1\n", "column mean is missing"),
        ("name,mean\na,fast\n", "holds no number"),
        ("name,mean\na,\n", "no finite mean"),
        ("", "not a CSV file"),
    ],
)
def test_a_wrong_file_of_reference_costs_is_told(tmp_path, content, message):
    path = tmp_path / "reference.csv"
    path.write_text(content)
    with pytest.raises(ReferenceCostError, match=message):
        read_reference(path)
