"""Intervals of a linear model with correlated residuals and a prior, against many drawn units."""

import numpy as np
import pytest
import torch

from deepkoco.fit.fit import Fit
from deepkoco.fit.solve.deflated import deflated

SAMPLES, RHO = 400, 0.8
# A first-order process counts as (1 + rho) / (1 - rho) times fewer samples for slopes that change slowly: 9.
DEFLATION = (1.0 + RHO) / (1.0 - RHO)
STATED = np.array([0.1, 0.4, 2.0])


def slopes():
    """(n, 3): one parameter of which the data tell little, one of as much as is stated, one of nearly all."""
    along = np.linspace(-1.0, 1.0, SAMPLES)
    return np.column_stack([np.ones(SAMPLES) * 0.1, along * 0.3, along**2])


def fit_of(information, precision):
    none, names = torch.zeros(0), ("a", "b", "c")
    values = dict.fromkeys(names, 0.0)
    covariance = np.linalg.inv(information + precision)
    return Fit("fit", names, values, covariance, information, none, none, 0.0, 0.0, none)


def drawn(narrowed, units=4000):
    """Squared errors (units, 3) of estimates, and their fit, where the prior of the fit is narrower than the units."""
    rng, a = np.random.default_rng(0), slopes()
    noise = np.empty((units, SAMPLES))
    noise[:, 0] = rng.normal(size=units)
    for k in range(1, SAMPLES):
        noise[:, k] = RHO * noise[:, k - 1] + np.sqrt(1.0 - RHO**2) * rng.normal(size=units)
    true = rng.normal(size=(units, 3)) * STATED
    information, precision = a.T @ a, np.diag(narrowed / STATED**2)
    found = (true @ a.T + noise) @ a @ np.linalg.inv(information + precision)
    return (found - true) ** 2, fit_of(information, precision)


@pytest.mark.parametrize("narrowed", [1.0, 4.0, DEFLATION])
def test_intervals_cover_the_units_of_which_a_prior_was_stated(narrowed):
    errors, fit = drawn(narrowed)
    variance = deflated(fit, DEFLATION, narrowed).diagonal()
    # 4000 units leave 0.35 % of chance; the slopes are not quite slow, which costs another per cent.
    assert (errors <= 1.96**2 * variance).mean(0) == pytest.approx(0.95, abs=0.015)
    assert errors.mean(0) == pytest.approx(variance, rel=0.08)


def test_what_the_data_do_not_tell_is_as_wide_as_it_was_stated():
    # The deflation times the whole covariance was 9 times this variance.
    fit = fit_of(np.zeros((3, 3)), np.diag(1.0 / STATED**2))
    assert deflated(fit, DEFLATION, 1.0).diagonal() == pytest.approx(STATED**2)


def test_what_the_data_tell_alone_is_as_wide_as_the_residuals_are_fewer():
    information = 1e12 * np.diag(1.0 / STATED**2)
    fit = fit_of(information, np.diag(1.0 / STATED**2))
    assert deflated(fit, DEFLATION, 1.0).diagonal() == pytest.approx(DEFLATION * fit.covariance.diagonal())


def test_a_prior_that_counts_as_the_residuals_do_is_divided_with_them():
    fit = fit_of(np.diag(1.0 / STATED**2), np.diag(DEFLATION / STATED**2))
    assert np.array_equal(deflated(fit, DEFLATION, DEFLATION), DEFLATION * fit.covariance)
    assert np.array_equal(deflated(fit, DEFLATION, np.inf), DEFLATION * fit.covariance)


def test_rounding_leaves_no_variance_outside_of_what_either_part_allows():
    # Two parameters in nearly one direction, of very different sizes.
    way = np.array([[1.0, 1.0 + 1e-9], [1.0 - 1e-9, 1.0]])
    size = np.array([1e-6, 1e5, 1.0])
    information = np.zeros((3, 3))
    information[:2, :2] = 1e14 * way.T @ way
    information = information / np.outer(size, size)
    fit = fit_of(information, np.diag(1.0 / size**2))
    variance = deflated(fit, DEFLATION, 1.0).diagonal()
    assert (variance >= fit.covariance.diagonal() * (1.0 - 1e-9)).all()
    assert (variance <= DEFLATION * fit.covariance.diagonal() * (1.0 + 1e-9)).all()
