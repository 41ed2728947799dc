"""Rollouts, errors against the horizon, and the residual of linearity."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.analysis.measures.horizon import draw_horizon, horizon_errors
from deepkoco.analysis.measures.linearity import draw_linearity, linearity_residual
from deepkoco.analysis.measures.rollout import roll_out


def windows(steps, horizon):
    return steps.windows(horizon, 1000, np.random.default_rng(0))


def test_windows_lie_inside_one_episode(exact):
    _, steps = exact  # 40, 25 and 3 steps
    first = windows(steps, 10)
    assert first.tolist() == [*range(30), *range(40, 55)]
    assert windows(steps, 40).size == 0
    drawn = steps.windows(10, 5, np.random.default_rng(1))
    assert drawn.size == 5
    assert set(drawn) <= set(first)


def test_an_exactly_linear_system_is_predicted_without_error(exact):
    model, steps = exact
    rollout = roll_out(model, steps, windows(steps, 12), 12)
    errors = horizon_errors(rollout)
    np.testing.assert_allclose(errors.latent, 0.0, atol=1e-10)
    np.testing.assert_allclose(errors.cost, 0.0, atol=1e-9)
    np.testing.assert_allclose(linearity_residual(rollout), 0.0, atol=1e-10)
    assert draw_linearity(rollout, rollout.costs[:, 0], rollout.costs[:, 1], ("x", "y")).table.shape[0] == 41


def test_a_wrong_eigenvalue_leaves_the_residual_it_must(exact):
    model, steps = exact
    wrong = replace(model, mu=model.mu + np.array([0.3, 0.0]))
    rollout = roll_out(wrong, steps, windows(steps, 1), 1)
    # Only the free motion of the first pair differs, by |s_pair| |e^{0.03} - 1| |lambda|.
    pair = np.linalg.norm(rollout.latents[:, 0, :2], axis=-1)
    flat = rollout.encoded.reshape(-1, 4)
    spread = np.sqrt(flat.var(0).sum())
    expected = pair * (np.exp(0.03) - 1) * np.exp(-0.05) / spread
    np.testing.assert_allclose(linearity_residual(rollout), expected, rtol=1e-9)
    errors = horizon_errors(rollout)
    assert errors.latent[0] == 0.0
    assert errors.latent[1] == pytest.approx(np.sqrt(np.square(expected).mean()))


def test_the_picture_marks_both_horizons_and_compares(exact):
    model, steps = exact
    errors = horizon_errors(roll_out(model, steps, windows(steps, 8), 8))
    picture = draw_horizon({"DeepKoCo": errors, "EDMDc": errors}, 4, 3, 0.1, 10)
    texts = [text.get_text() for axes in picture.figure.axes for text in axes.texts]
    assert texts == ["H", "T", "H", "T"]
    assert len(picture.table) == 18
    assert picture.table["time_s"].max() == pytest.approx(0.8)
