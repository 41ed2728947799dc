"""Which inputs a model looks at, and the maps of B and C."""

from dataclasses import replace

import numpy as np
import pytest
from handmade_models import linear_model

from deepkoco.analysis.measures.input_maps import draw_input_maps, input_maps
from deepkoco.analysis.measures.inputs import Inputs
from deepkoco.analysis.measures.points import Points
from deepkoco.analysis.measures.sensitivity import draw_sensitivity, input_sensitivity
from deepkoco.koopman import KoopmanModel, ModelConfig, export_model

NAMES = ("a", "b", "c")


def visited(seed=0, entries=3):
    generator = np.random.default_rng(seed)
    return generator.normal(size=(200, entries)) * np.arange(1, entries + 1), generator.normal(size=(200, 1))


def test_an_input_that_the_encoder_ignores_has_zero_sensitivity():
    model = export_model(KoopmanModel(3, 1, ModelConfig(2, 0.1, (8,), (8,))))
    model.encoder[0][0][:, 1] = 0.0
    found = input_sensitivity(model, *visited(), horizon=4)
    assert found.latent[1] == found.cost[1] == 0.0
    assert (found.latent[[0, 2]] > 0).all()


def test_a_linear_encoder_has_the_sensitivity_of_its_weights():
    weights = np.array([[1.0, 0.0, 2.0, 0.0], [0.0, 0.5, 1.0, 0.0]])
    model = linear_model(weights, np.array([[1.0, 0.0]]), np.array([0.0]), np.array([0.0]))
    observations, actions = visited()
    found = input_sensitivity(model, observations, actions, horizon=0)
    latents = observations @ weights[:, :3].T
    spread = np.sqrt(latents.var(0).sum())
    expected = np.linalg.norm(weights[:, :3], axis=0) * observations.std(0) / spread
    np.testing.assert_allclose(found.latent, expected, rtol=1e-9)
    # cost = y^2 with y = s_0, so dc/do = 2 y w: root mean square 2 |w| sqrt(E y^2)
    y = latents[:, 0]
    expected = (
        2 * np.abs(weights[0, :3]) * np.sqrt(np.square(y).mean()) * observations.std(0) / np.square(y).std()
    )
    np.testing.assert_allclose(found.cost, expected, rtol=1e-6)


def test_an_input_that_never_moves_counts_for_nothing():
    model = linear_model(np.ones((2, 4)), np.array([[1.0, 0.0]]), np.array([0.0]), np.array([0.0]))
    observations, actions = visited()
    observations[:, 2] = 1.0
    assert input_sensitivity(model, observations, actions, 0).latent[2] == 0.0


def test_the_picture_sets_task_inputs_against_distractors():
    model = linear_model(np.array([[2.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]]), np.array([[1.0, 0.0]]),
                         np.array([0.0]), np.array([0.0]))  # fmt: skip
    observations, actions = visited()
    found = input_sensitivity(model, observations / observations.std(0), actions, 0)
    inputs = Inputs(NAMES, np.array([True, False, False]), np.array([0]), np.array([0, 2, 1]))
    picture = draw_sensitivity(found, inputs)
    assert picture.table["input"].tolist() == ["a", "c", "b"]
    assert picture.table["belongs_to"].tolist() == ["task", "distractor", "distractor"]
    # 2 against the root mean square of 1 and 0
    assert f"{2 * np.sqrt(2):.3g} times" in picture.caption
    assert "mixes the task" in draw_sensitivity(found, replace(inputs, is_task=None)).caption


def test_maps_show_the_b_and_c_of_the_model():
    encoder = np.array([[1.0, 3.0], [0.0, 4.0]])
    model = linear_model(encoder, np.array([[2.0, -1.0]]), np.array([0.0]), np.array([1.0]))
    x = np.linspace(-1, 1, 6)
    points = Points(x[:, None], x, x, ("x", "y"))
    maps = input_maps(model, points, np.array([0.5]))
    np.testing.assert_allclose(maps.input_size, 5.0)
    np.testing.assert_allclose(maps.factor_size, np.sqrt(5.0))
    np.testing.assert_allclose(maps.gain, 2.0)  # 2 * 3 - 1 * 4
    np.testing.assert_allclose(maps.cost, np.square(2 * (x + 1.5) - 2.0))
    table = draw_input_maps(model, points, np.array([0.5])).table
    assert table["CB_0"].tolist() == pytest.approx([2.0] * 6)
