"""Contribution of each pair to the cost, and what is left when pairs are taken out."""

import numpy as np
import pandas as pd
import pytest
from handmade_models import linear_model
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from deepkoco.analysis.measures.contribution import cost_contribution, draw_contribution
from deepkoco.analysis.measures.eigenvalues import (
    draw_eigenvalues,
    draw_history,
    eigenvalue_table,
    spread_labels,
)
from deepkoco.analysis.measures.modes import find_modes
from deepkoco.analysis.measures.pruning import PrunedModel, control_pruned, draw_pruning, prune
from deepkoco.analysis.measures.rollout import roll_out
from deepkoco.analysis.measures.steps import join_steps
from deepkoco.analysis.page.analyse import pruned_well
from deepkoco.output.picture import Picture


def modes_of(model):
    return find_modes(model.dynamics, model.time_step)


def test_a_cost_that_reads_one_pair_is_made_by_that_pair(exact):
    model, steps = exact
    contribution = cost_contribution(model, modes_of(model), steps)
    np.testing.assert_allclose(contribution.shares, [1.0, 0.0], atol=1e-12)
    assert contribution.total == pytest.approx(steps.costs.mean())


@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_the_parts_sum_to_the_mean_cost(seed, rank):
    generator = np.random.default_rng(seed)
    model = linear_model(generator.normal(size=(4, 3)), generator.normal(size=(rank, 4)))
    data = generator.normal(size=(30, 2)), generator.normal(size=(30, 1)), np.zeros(30)
    contribution = cost_contribution(model, modes_of(model), join_steps([data]))
    assert contribution.parts.sum() == pytest.approx(contribution.total)
    assert contribution.shares.sum() == pytest.approx(1.0)


def test_pairs_that_cancel_have_parts_of_both_signs():
    # y = 3 o from the first pair and -2 o from the second: y = o, so the parts are 3 o^2 and -2 o^2.
    encoder = np.array([[1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [0.0, 0.0]])
    model = linear_model(encoder, np.array([[3.0, 0.0, -2.0, 0.0]]))
    steps = join_steps([(np.array([[1.0], [2.0]]), np.zeros((2, 1)), np.zeros(2))])
    contribution = cost_contribution(model, modes_of(model), steps)
    np.testing.assert_allclose(contribution.parts, [7.5, -5.0])
    np.testing.assert_allclose(contribution.sizes, [3 * np.sqrt(2.5), 2 * np.sqrt(2.5)])


def test_a_pair_that_the_cost_does_not_read_is_pruned_first_and_for_free(exact):
    model, steps = exact
    first = steps.windows(6, 1000, np.random.default_rng(0))
    pruning = prune(modes_of(model), roll_out(model, steps, first, 6), model.action_weight)
    assert pruning.removed.tolist() == [1, 0]
    np.testing.assert_allclose(pruning.errors[:2], 0.0, atol=1e-10)
    assert pruning.errors[2] > 0.1
    assert pruning.kept(1).tolist() == [True, False]
    done = control_pruned(pruning, model, modes_of(model), (2, 1), lambda m: np.array([1.0, 3.0]))
    assert done.closed_loop[1] == (2.0, pytest.approx(1.0))
    table = draw_pruning(done, 6, 2).table
    assert table["pairs_kept"].tolist() == [2, 1, 0]
    assert table["removed_last"].tolist()[1:] == [2, 1]  # counted from 1


def test_a_pruned_model_keeps_its_latent_and_loses_part_of_its_cost(exact):
    model, steps = exact
    everything = PrunedModel(model, model, modes_of(model).projection(np.array([True, True])))
    nothing = PrunedModel(model, model, modes_of(model).projection(np.array([False, True])))
    rows, factor = model.linearise(steps.observations, steps.actions)
    for pruned, expected in ((everything, factor), (nothing, np.zeros_like(factor))):
        pruned_rows, pruned_factor = pruned.linearise(steps.observations, steps.actions)
        np.testing.assert_array_equal(pruned_rows, rows)
        np.testing.assert_allclose(pruned_factor, expected, atol=1e-12)
        np.testing.assert_allclose(pruned.factor(rows[:, 0]), expected, atol=1e-12)
        assert pruned_factor.flags.c_contiguous


def test_eigenvalues_are_told_with_their_periods_and_doubling_times(exact):
    model, steps = exact
    contribution = cost_contribution(model, modes_of(model), steps)
    table = eigenvalue_table(modes_of(model), contribution)
    np.testing.assert_allclose(table["mu_per_s"], [-0.5, 0.2])
    np.testing.assert_allclose(table["period_s"], [np.pi, 2 * np.pi / 5])
    assert table["doubling_time_s"][1] == pytest.approx(np.log(2) / 0.2)
    np.testing.assert_allclose(table["modulus"], np.exp([-0.05, 0.02]))
    picture = draw_eigenvalues(modes_of(model), contribution)
    assert "1 of 2 grow here" in picture.caption
    assert draw_contribution(contribution, modes_of(model)).table["pair"].tolist() == [1, 2]


def test_the_history_is_drawn_where_a_run_has_one(tmp_path):
    path = tmp_path / "eigenvalues.csv"
    assert draw_history(path) is None
    path.write_text("episodes,mu_1,omega_1\n0,0,1\n")
    assert draw_history(path) is None  # nothing has moved yet
    path.write_text("episodes,mu_1,omega_1\n0,0,1\n90,0.5,1.5\n")
    picture = draw_history(path)
    assert picture is not None
    assert "after the 90 episodes" in picture.caption


def test_labels_are_moved_apart_as_little_as_possible():
    # 1.0 and 1.2 are less than 0.5 apart: both move by 0.15, the others stay where they belong.
    np.testing.assert_allclose(spread_labels(np.array([3.0, 1.2, 1.0, -1.0]), 0.5), [3.0, 1.35, 0.85, -1.0])


def test_a_model_is_as_large_as_the_least_number_down_to_which_all_do_well():
    table = pd.DataFrame(
        {"pairs_kept": [5, 4, 3, 2, 1], "closed_loop_cost": [100.0, 105.0, 300.0, 101.0, np.nan]}
    )
    assert pruned_well(Picture("pruning", "", "", Figure(), table)) == (4, 5)
    table["closed_loop_cost"] = np.nan
    assert pruned_well(Picture("pruning", "", "", Figure(), table)) is None
