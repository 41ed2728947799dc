"""scaled_inverse by hand and by its properties."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.fit.solve.scaled_inverse import DivergedError, scaled_inverse


def positive(size: int, seed: int, units: float = 0.0) -> np.ndarray:
    """A random positive definite matrix; the units of its rows differ by 10^(+-units)."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size, 2 * size))
    scale = 10.0 ** rng.uniform(-units, units, size)
    return root @ root.T * np.outer(scale, scale)


def test_scaled_inverse_of_a_diagonal_matrix_by_hand():
    assert scaled_inverse(np.diag([4.0, 0.25])) == pytest.approx(np.diag([0.25, 4.0]))


@settings(max_examples=50, deadline=None)
@given(size=st.integers(1, 8), seed=st.integers(0, 1000))
def test_scaled_inverse_inverts_in_all_units(size, seed):
    # The plain pseudo-inverse sets eigenvalues below 1e-15 of the largest to 0.
    matrix = positive(size, seed, units=12.0)
    root = np.sqrt(np.diag(matrix))
    result = scaled_inverse(matrix) * root[:, None] * root
    assert result @ (matrix / np.outer(root, root)) == pytest.approx(np.eye(size), abs=1e-6)


@settings(max_examples=50, deadline=None)
@given(size=st.integers(1, 6), seed=st.integers(0, 1000))
def test_scaled_inverse_changes_with_units_like_the_inverse(size, seed):
    matrix = positive(size, seed)
    units = 10.0 ** np.random.default_rng(seed).uniform(-9.0, 9.0, size)
    other = scaled_inverse(matrix * np.outer(units, units)) * np.outer(units, units)
    expected = scaled_inverse(matrix)
    assert other == pytest.approx(expected, rel=1e-6, abs=1e-9 * np.abs(expected).max())


def test_scaled_inverse_keeps_rows_of_zeros():
    matrix = np.zeros((3, 3))
    matrix[:2, :2] = [[2.0, 1.0], [1.0, 2.0]]
    result = scaled_inverse(matrix)
    assert result[:2, :2] == pytest.approx(np.array([[2.0, -1.0], [-1.0, 2.0]]) / 3.0)
    assert (result[2] == 0.0).all()
    assert (result[:, 2] == 0.0).all()


def test_scaled_inverse_accepts_a_slightly_negative_diagonal():
    result = scaled_inverse(np.diag([4.0, -1e-12]))
    assert result == pytest.approx(np.diag([0.25, -1e12]))


def test_scaled_inverse_of_a_stack_equals_single_inverses():
    stack = np.stack([positive(3, seed) for seed in range(4)])
    for one, own in zip(scaled_inverse(stack), stack, strict=True):
        assert one == pytest.approx(scaled_inverse(own))


def test_scaled_inverse_of_an_empty_matrix_is_empty():
    assert scaled_inverse(np.zeros((0, 0))).shape == (0, 0)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [(0, 0), (0, 1), (2, 2)])
def test_scaled_inverse_names_the_row_that_is_not_finite(wrong, place):
    matrix = positive(3, 0)
    matrix[place] = matrix[place[::-1]] = wrong
    with pytest.raises(DivergedError, match=f"rows .*{place[0]}.* not finite"):
        scaled_inverse(matrix)


def test_scaled_inverse_refuses_overflow_of_the_scaling():
    with pytest.raises(DivergedError):
        scaled_inverse(np.array([[1e-300, 1e300], [1e300, 1.0]]))
