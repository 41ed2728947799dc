"""Sines and exponentials of rows of numbers against those of the library."""

import numpy as np
import pytest
from numba import njit

from deepkoco.fit.simulate.bytecode.machine import OPCODES, execute
from deepkoco.systems.sines import FADED, FARTHEST, faded, near_sine_and_cosine


@njit
def _of_each(x, sine, cosine):
    for i in range(len(x)):
        sine[i], cosine[i] = near_sine_and_cosine(x[i])


@njit
def _faded(x, result):
    for i in range(len(x)):
        result[i] = faded(x[i])


def test_what_has_faded_is_that_of_the_library():
    rng = np.random.default_rng(0)
    x = np.concatenate([10.0 ** rng.uniform(-300.0, 2.0, 20000), [0.0, FADED, 1e300, np.inf]])
    found = np.empty_like(x)
    _faded(x, found)
    np.testing.assert_allclose(found, -np.expm1(-x), rtol=4e-15, atol=0.0)


def test_sines_near_zero_and_far_away_are_those_of_the_library():
    rng = np.random.default_rng(0)
    x = np.concatenate([rng.uniform(-r, r, 5000) for r in (1e-3, 1.0, 7.0, 300.0, FARTHEST)])
    x = np.concatenate([x, np.arange(-40, 41) * 0.25 * np.pi])
    sine, cosine = np.empty_like(x), np.empty_like(x)
    _of_each(x, sine, cosine)
    assert np.abs(sine - np.sin(x)).max() < 3e-16
    assert np.abs(cosine - np.cos(x)).max() < 3e-16


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_bytecode_has_the_sine_of_any_number(name):
    given = np.array([0.0, 0.7, -3.0, 2.0 * FARTHEST, -1e300, np.nan, np.inf])
    table = np.zeros((2, len(given)))
    table[1] = given
    execute(np.array([[OPCODES.index(name), 0, 1, 1, 1]]), table, len(given))
    with np.errstate(invalid="ignore"):
        np.testing.assert_allclose(table[0], getattr(np, name)(given), rtol=1e-14, atol=3e-16)
    execute(np.array([[OPCODES.index(name), 0, 1, 1, 1]]), table, 3)
    np.testing.assert_allclose(table[0, :3], getattr(np, name)(given[:3]), rtol=1e-14, atol=3e-16)
