"""What the planner asks of a program: the optimisation that is solved at every step."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from scipy.linalg import get_lapack_funcs

from deepkoco.koopman.latent_model import LatentModel
from deepkoco.planning.config import Array
from deepkoco.planning.errors import PlannerConfigError

_FACTORISE, _ESTIMATE = get_lapack_funcs(("potrf", "pocon"), dtype=np.float64)


@runtime_checkable
class DecodableModel(Protocol):
    """A latent model that can be linearised at a predicted latent."""

    def linearise_along(self, latents: Array, actions: Array) -> tuple[Array, Array]:
        """Columns of B_k as rows (..., M, n) and C_k (..., r, n) at latents (..., n) and actions (..., M)."""
        ...


def check_decoder(model: LatentModel) -> DecodableModel:
    """Check that a model can be linearised at predicted latents.

    Args:
        model: The latent model.

    Returns:
        The same model.

    Raises:
        PlannerConfigError: It has no decoder.
    """
    reason = "it cannot be linearised at predicted latents"
    if isinstance(model, DecodableModel):
        try:
            model.linearise_along(np.zeros(model.dynamics.latent_size), np.zeros(model.action_size))
        except ValueError as error:
            reason = str(error)
        else:
            return model
    raise PlannerConfigError(
        f'planner.linearisation = "along_plan" or "tangent" does not go with this model: {reason}; '
        'or give planner.linearisation="frozen"'
    )


class Optimisation(Protocol):
    """What every program tells of its last solve, whatever it takes."""

    @property
    def iterations(self) -> int:
        """Of the last solve."""
        ...

    @property
    def refined(self) -> bool:
        """Whether the solver's last solution was too far from the optimum and was replaced."""
        ...

    def reset(self) -> None:
        """Forget all earlier steps."""
        ...

    def planned_cost(self, planned: Array) -> float:
        """Predicted sum of |C_k s_k|^2 + R a_k'a_k over k = 1 .. H of a plan (H, M) for the last problem."""
        ...

    def conditioning(self) -> float:
        """Estimated condition number of the last problem's Hessian; NaN where there is none."""
        ...


class Program(Optimisation, Protocol):
    """One optimisation over the actions of the next H steps."""

    def solve(self, rows: Array, factor: Array, action: Array) -> Array:
        """Plan.

        Args:
            rows: Latent and input columns (1 + M, n) as given by `LatentModel.linearise`.
            factor: Cost factor C (r, n).
            action: Present action a_0 (M,).

        Returns:
            Planned actions a_1 .. a_H (H, M).

        Raises:
            SolverError: The program was not solved.
        """
        ...


class VaryingProgram(Optimisation, Protocol):
    """A program with B_k and C_k of their own at every step."""

    def solve_varying(
        self, latent: Array, inputs: Array, factors: Array, action: Array, offsets: Array | None = None
    ) -> Array:
        """Plan.

        Args:
            latent: s_0 (n,).
            inputs: Columns of B_0 .. B_{H-1} as rows (H, M, n).
            factors: C_1 .. C_H (H, r, n).
            action: Present action a_0 (M,).
            offsets: e_1 .. e_H (H, r) of y_k = C_k s_k + e_k; None for zero.

        Returns:
            Planned actions a_1 .. a_H (H, M).

        Raises:
            SolverError: The program was not solved.
        """
        ...


def estimated_condition(hessian: Array) -> float:
    """Estimate the condition number of a positive definite matrix in a fraction of an SVD's time.

    Args:
        hessian: (n, n), symmetric.

    Returns:
        A lower bound on the condition number in the 1-norm, as a rule within a factor of three of it;
        infinity where the matrix is not positive definite.

    Source: Higham, FORTRAN codes for estimating the one-norm of a real or complex matrix, ACM TOMS 1988.
    """
    factor, failed = _FACTORISE(hessian)
    if failed:
        return float("inf")
    reciprocal, _ = _ESTIMATE(factor, np.abs(hessian).sum(0).max())
    return float(1.0 / reciprocal) if reciprocal > 0 else float("inf")


def shifted(planned: Array) -> Array:
    """A plan seen one step later: its last action is held.

    Args:
        planned: a_1 .. a_H (H, M).

    Returns:
        a_2 .. a_H, a_H (H, M).
    """
    return np.concatenate((planned[1:], planned[-1:]))
