"""Singular values of a matrix, also where the faster of two methods does not converge."""

from __future__ import annotations

import numpy as np
import scipy.linalg


def thin_svd(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return U, s and V^T of the thin singular value decomposition of a finite matrix.

    Divide and conquer fails on a few matrices, which differ from others in the last bits only: where all entries are
    those of rounding, for example. The iteration by QR, which is slower, then stands in for it.

    Args:
        matrix: (m, n).

    Raises:
        LinAlgError: The matrix is not finite.

    Source: Anderson et al., LAPACK Users' Guide (1999): drivers xGESDD and xGESVD.
    """
    try:
        left, values, right = np.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        if not np.isfinite(matrix).all():
            raise
        return scipy.linalg.svd(matrix, full_matrices=False, lapack_driver="gesvd")
    return left, values, right
