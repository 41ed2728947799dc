"""Sums over windows compared with the dense normal distribution of all measurements."""

import numpy as np
import pytest
import scipy.stats

from deepkoco.diagnose.probability.gram import Gram, KeptColumns, UnitLoads, WindowSums, misfit
from deepkoco.diagnose.probability.normal import Changes, Normal

FLAT = 1e4  # standard deviation that stands for a flat prior


def problem(seed: int, windows: int = 3, samples: int = 12, coordinates: int = 4, loads: int = 5):
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((windows, samples, coordinates))
    states = rng.standard_normal((windows, samples, 2))
    responses = rng.standard_normal((windows, samples, loads))
    residual = 2.0 * rng.standard_normal((windows, samples))
    return columns, states, responses, residual


def dense(parts, amplitude: float, sd: np.ndarray, mean: np.ndarray) -> float:
    """Log density of all measurements at once; the flat prior of the states costs log(FLAT) each."""
    columns, states, responses, residual = parts
    windows, samples, _ = columns.shape
    tall = columns.reshape(windows * samples, -1)
    covariance = np.eye(windows * samples) + tall @ np.diag(sd**2) @ tall.T
    for w in range(windows):
        mine = slice(w * samples, (w + 1) * samples)
        covariance[mine, mine] += FLAT**2 * states[w] @ states[w].T
        covariance[mine, mine] += amplitude**2 * responses[w] @ responses[w].T
    found = scipy.stats.multivariate_normal(tall @ mean, covariance).logpdf(residual.ravel())
    constant = 0.5 * windows * samples * np.log(2.0 * np.pi)
    return found + constant + windows * states.shape[2] * np.log(FLAT)


@pytest.mark.parametrize("amplitude", [0.0, 0.7])
def test_sums_beside_kept_columns_are_those_of_all_columns(amplitude):
    columns, states, responses, residual = problem(5, coordinates=6)
    wanted = WindowSums(columns, states, responses, residual)
    found = KeptColumns.of(columns[:, :, 2:], UnitLoads.of(responses)).beside(
        columns[:, :, :2], states, residual
    )
    assert found.coordinates == wanted.coordinates
    np.testing.assert_allclose(found.products(amplitude), wanted.products(amplitude), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("amplitude", [0.0, 0.3, 4.0])
def test_evidence_without_a_change_is_that_of_the_dense_normal_distribution(amplitude):
    parts, sd, mean = problem(1), np.array([0.1, 2.0, 0.5, 1e-3]), np.array([0.3, -1.0, 0.0, 0.0])
    prior = Normal.of(mean, np.diag(1.0 / sd**2))
    found = Changes.of(WindowSums(*parts).at(amplitude), prior).log_nothing
    assert found == pytest.approx(dense(parts, amplitude, sd, mean), abs=1e-4)


def test_a_change_adds_to_its_coordinate_and_to_nothing_else():
    parts, sd, mean = problem(2), np.array([0.1, 2.0, 0.5, 1e-3]), np.zeros(4)
    changes = Changes.of(WindowSums(*parts).at(0.7), Normal.of(mean, np.diag(1.0 / sd**2)))
    d = np.array([0.4, 0.0, -0.3, 0.2])
    found = changes.log_nothing + changes.pull @ d - 0.5 * d @ changes.information @ d
    assert found == pytest.approx(dense(parts, 0.7, sd, mean + d), abs=1e-4)


def test_other_coordinates_are_combinations_of_the_columns():
    columns, states, responses, residual = problem(3)
    matrix = np.random.default_rng(4).standard_normal((4, 2))
    combined = WindowSums(columns @ matrix, states, responses, residual).at(0.5)
    mapped = WindowSums(columns, states, responses, residual).at(0.5).mapped(matrix)
    np.testing.assert_allclose(mapped.information, combined.information, rtol=1e-9)
    np.testing.assert_allclose(mapped.pull, combined.pull, rtol=1e-9)


def test_a_column_that_no_healthy_unit_has_is_a_change_only():
    parts, sd = problem(6), np.array([0.1, 2.0])
    prior, inside = Normal.independent(sd), np.array([3, 0])
    changes = Changes.of(WindowSums(*parts).at(0.7), prior, inside)
    d = np.array([0.4, 0.0, -0.3, 0.2])
    found = changes.log_nothing + changes.pull @ d - 0.5 * d @ changes.information @ d
    # A standard deviation of 0 keeps a coordinate at its mean.
    assert found == pytest.approx(dense(parts, 0.7, np.array([2.0, 0.0, 0.0, 0.1]), d), abs=1e-4)


def test_the_misfit_of_a_residual_is_that_of_the_dense_covariance():
    _, _, responses, residual = problem(5)
    wanted = sum(
        r @ np.linalg.solve(np.eye(len(r)) + 0.6**2 * R @ R.T, r)
        for R, r in zip(responses, residual, strict=True)
    )
    assert misfit(UnitLoads.of(responses), residual, 0.6) == pytest.approx(wanted, rel=1e-9)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [np.inf, np.nan, 1e200])
def test_the_misfit_of_a_diverged_simulation_is_infinite(size):
    _, _, responses, residual = problem(6)
    residual[1, 5:] = size
    assert misfit(UnitLoads.of(responses), residual, 0.6) == np.inf


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_information_of_simulations_that_nearly_diverge_is_refused_as_no_matrix(value):
    information = np.eye(3)
    information[2, 1] = information[1, 2] = value
    with pytest.raises(np.linalg.LinAlgError, match="not finite"):
        Changes.of(Gram(information, np.zeros(3), 1.0, 0.0), Normal.of(np.zeros(3), np.eye(3)))
