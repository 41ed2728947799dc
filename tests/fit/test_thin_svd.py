"""Singular values where the faster method does not converge."""

import numpy as np
import pytest

from deepkoco.fit.solve.thin_svd import thin_svd


@pytest.mark.parametrize("shape", [(7, 3), (3, 7), (5, 5)])
def test_the_slower_method_stands_in_for_the_faster_one(shape, monkeypatch):
    matrix = np.random.default_rng(0).normal(size=shape)
    wanted = np.linalg.svd(matrix, compute_uv=False)

    def fails(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    for _ in range(2):
        left, values, right = thin_svd(matrix)
        np.testing.assert_allclose(values, wanted, rtol=1e-12)
        np.testing.assert_allclose(left * values @ right, matrix, rtol=0.0, atol=1e-12)
        monkeypatch.setattr(np.linalg, "svd", fails)


def test_a_matrix_that_is_not_finite_is_refused():
    with pytest.raises(np.linalg.LinAlgError):
        thin_svd(np.array([[1.0, np.nan], [0.0, 1.0]]))
