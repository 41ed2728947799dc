"""DeepKoopman autoencoders: closed forms for spectra that depend on the latent."""

from itertools import pairwise

import numpy as np
import pytest
from safetensors.numpy import save_file
from scipy.linalg import expm

from deepkoco.interchange.deepkoopman import DeepKoopmanError, read_deepkoopman
from deepkoco.koopman.lifting.edmdc import TargetCost
from deepkoco.planning import PlannerConfig
from deepkoco.planning.methods import make_planner

DT = 0.05


def oscillator_weights():
    """y = o; one pair with omega = 1 + r^2 and mu = -0.1, one real eigenvalue mu = -0.5, all layers affine."""
    return {
        "WE1": np.eye(3),
        "bE1": np.zeros(3),
        "WD1": np.eye(3),
        "bD1": np.zeros(3),
        "WOC1_1": np.array([[1.0, 0.0]]),
        "bOC1_1": np.array([1.0, -0.1]),
        "WOR1_1": np.array([[0.0]]),
        "bOR1_1": np.array([-0.5]),
    }


def random_weights(seed, hidden=6):
    """Two inputs, one pair, two-layer networks."""
    rng = np.random.default_rng(seed)

    def network(name, *widths):
        layers = pairwise(widths)
        return {
            f"{kind}{name}{i}": rng.normal(size=(a, b) if kind == "W" else b) * 0.5
            for i, (a, b) in enumerate(layers, 1)
            for kind in "Wb"
        }

    return network("E", 2, hidden, 2) | network("D", 2, hidden, 2) | network("OC1_", 1, hidden, 2)


def test_a_spectrum_that_depends_on_the_radius_gives_the_closed_form():
    weights = oscillator_weights()
    weights["bOC1_1"] = np.array([1.0, 0.0])  # without damping the radius, and with it omega, stays
    model = read_deepkoopman(weights, DT)
    start = np.array([0.6, 0.8, 2.0])
    steps = np.arange(41)
    angle = 2.0 * steps * DT  # r^2 = 1
    expected = np.column_stack(
        (
            0.6 * np.cos(angle) - 0.8 * np.sin(angle),
            0.6 * np.sin(angle) + 0.8 * np.cos(angle),
            2.0 * np.exp(-0.5 * steps * DT),
        )
    )
    np.testing.assert_allclose(model.predict(start, 40), expected, atol=1e-12)


def test_the_transition_is_the_exponential_of_its_rates():
    model = read_deepkoopman(oscillator_weights(), DT)
    latent = np.array([0.3, 0.4, 1.0])
    omega = 1.25
    generator = np.array([[-0.1, -omega, 0], [omega, -0.1, 0], [0, 0, -0.5]])
    np.testing.assert_allclose(model.transition(latent), expm(generator * DT), atol=1e-12)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(model.transition(latent))),
        np.sort_complex([*model.eigenvalues(latent), model.eigenvalues(latent)[0].conj()]),
    )


@pytest.mark.parametrize("activation", ["relu", "sigmoid", "elu"])
def test_networks_are_those_of_the_published_layout(activation):
    weights = random_weights(0)
    model = read_deepkoopman(weights, DT, activation)
    x = np.random.default_rng(1).normal(size=(4, 2))
    before = x @ weights["WE1"] + weights["bE1"]
    hidden = {
        "relu": np.maximum(before, 0),
        "sigmoid": 1 / (1 + np.exp(-before)),
        "elu": np.where(before > 0, before, np.exp(before) - 1),
    }[activation]
    np.testing.assert_allclose(model.encode(x), hidden @ weights["WE2"] + weights["bE2"], atol=1e-12)
    # The decoder's Jacobian against differences; a kink of relu nowhere near.
    y, h = np.array([0.31, -0.22]), 1e-6
    columns = [(model.decode(y + h * e) - model.decode(y - h * e)) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(model.decoder.jacobian(y), np.stack(columns, -1), atol=1e-8)


def test_files_in_both_layouts_give_the_same_model(tmp_path):
    weights = random_weights(2)
    save_file(weights, tmp_path / "w.safetensors")
    (tmp_path / "csv").mkdir()
    for name, array in weights.items():
        np.savetxt(tmp_path / "csv" / f"Pendulum_2017_11_{name}.csv", array, delimiter=",")
    np.savetxt(tmp_path / "csv" / "Pendulum_2017_11_error.csv", np.ones(3))
    start = np.array([0.2, 0.1])
    expected = read_deepkoopman(weights, DT).predict(start, 10)
    np.testing.assert_array_equal(
        read_deepkoopman(tmp_path / "w.safetensors", DT).predict(start, 10), expected
    )
    np.testing.assert_allclose(
        read_deepkoopman(tmp_path / "csv", DT).predict(start, 10), expected, atol=1e-12
    )


def test_fitted_inputs_and_a_frozen_spectrum_control_the_system():
    model = read_deepkoopman(oscillator_weights(), DT)
    inputs = np.array([[0.0], [0.1], [0.05]])
    rng = np.random.default_rng(3)

    def step(x, a):
        return model.transition(x) @ x + inputs @ a

    observations, actions = [], []
    for _ in range(4):
        x, a, episode = rng.normal(size=3), rng.normal(size=(30, 1)), []
        for k in range(30):
            episode.append(x)
            x = step(x, a[k])
        observations.append(np.array(episode))
        actions.append(a)
    np.testing.assert_allclose(model.fit_inputs(observations, actions), inputs, atol=1e-10)

    cost = TargetCost([1.0, 1.0, 0.1], [0.0, 0.0, 0.0], 0.001)
    latent_model = model.latent_model(np.zeros(3), model.fit_inputs(observations, actions), cost)
    planner = make_planner(latent_model, PlannerConfig(30, 0.001), np.array([-2.0]), np.array([2.0]))

    def total(controlled):
        x, a, sum_ = np.array([1.0, 0.0, 0.5]), np.zeros(1), 0.0
        for _ in range(120):
            sum_ += x @ np.diag([1, 1, 0.1]) @ x
            rows, factor = latent_model.linearise(x, a)
            following = a + planner.plan(rows, factor, a) if controlled else a
            x, a = step(x, a), following
        return sum_, x

    (controlled, x), (free, _) = total(True), total(False)
    assert controlled < 0.5 * free
    assert np.abs(x).max() < 0.05


def test_a_target_cost_goes_through_the_linearised_decoder():
    model = read_deepkoopman(random_weights(4), DT, "sigmoid")
    at, target = np.array([0.1, -0.2]), np.array([0.5, 0.4])
    latent_model = model.latent_model(at, np.ones((2, 1)), TargetCost([2.0, 1.0], target, 0.0))
    y = model.encode(at)
    error = model.decode(y) - target
    expected = 2.0 * error[0] ** 2 + error[1] ** 2
    np.testing.assert_allclose(latent_model.cost(y, np.zeros(1)), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"WE1": None}, "WE1 is missing"),
        ({"bD2": None}, "bD2 is missing"),
        ({"WE2": np.ones((5, 2))}, "network E"),
        ({"WE2": np.ones((6, 3)), "bE2": np.ones(3)}, "make 2 latents"),
        ({"WOC1_2": np.ones((6, 1)), "bOC1_2": np.ones(1)}, "should have 1 and 2"),
        ({"WD1": np.full((2, 6), np.nan)}, "not finite"),
        ({"WX1": np.ones((2, 2))}, "WX1 belongs to no layer"),
        ({"WE1": "x"}, "layer E1 holds"),
        ({"bE1": [[1.0], [1.0, 2.0]]}, "layer E1 holds"),
        ({"WD2": np.ones((6, 3)), "bD2": np.ones(3)}, "decoder gives 3"),
    ],
)
def test_arrays_that_do_not_fit_are_named(change, message):
    weights = {k: v for k, v in {**random_weights(0), **change}.items() if v is not None}
    with pytest.raises(DeepKoopmanError, match=message):
        read_deepkoopman(weights, DT)


def test_what_is_no_file_of_weights_is_named(tmp_path):
    (tmp_path / "w.safetensors").write_bytes(b"no")
    with pytest.raises(DeepKoopmanError, match="cannot be read"):
        read_deepkoopman(tmp_path / "w.safetensors", DT)
    for name in ("One_WE1.csv", "One_bE1.csv", "Two_WE1.csv"):
        (tmp_path / name).write_text("1.0\n")
    with pytest.raises(DeepKoopmanError, match="both hold WE1"):
        read_deepkoopman(tmp_path, DT)
    (tmp_path / "Two_WE1.csv").unlink()
    (tmp_path / "One_bE1.csv").write_text("")
    with pytest.warns(UserWarning, match="no data"), pytest.raises(DeepKoopmanError, match="network E"):
        read_deepkoopman(tmp_path, DT)
    with pytest.raises(DeepKoopmanError, match="time_step"):
        read_deepkoopman(random_weights(0), 0.0)
    with pytest.raises(DeepKoopmanError, match="activation"):
        read_deepkoopman(random_weights(0), DT, "gelu")
