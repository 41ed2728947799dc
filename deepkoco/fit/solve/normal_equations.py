"""Normal equations of multiple shooting; the initial states of the windows are eliminated."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.solve.scaled_inverse import DivergedError, scaled_inverse


@dataclass
class NormalEquations:
    """Gauss-Newton equations of one trial: q parameters (nuisances of the logs last), S states in each of W windows.

    The initial state of a window is coupled to the parameters, but not to other windows. It is eliminated window by
    window. The reduced equations then contain the q parameters only.

    Attributes:
        residual: (W, N, M) residuals in noise standard deviations.
        chi2: Sum of their squares.
        cost: chi2 plus the prior's penalty.
        hpp: (q, q) curvature of the parameters, prior included.
        hps: (W, q, S) mixed curvature of parameters and states.
        hss: (W, S, S) curvature of the states.
        gp: (q,) descent direction of the parameters, prior included.
        gs: (W, S) descent direction of the states.
    """

    residual: Tensor
    chi2: float
    cost: float
    hpp: Tensor  # (q, q), prior included
    hps: Tensor  # (W, q, S)
    hss: Tensor  # (W, S, S)
    gp: Tensor  # (q,), prior included
    gs: Tensor  # (W, S)

    @staticmethod
    def build(
        residual: Tensor,
        slopes: Tensor,
        state_slopes: Tensor,
        nuisance_slopes: Tensor,
        prior: Tensor,
        offset: Tensor,
        nuisance: Tensor,
        precision: Tensor,
    ) -> NormalEquations:
        """Form the equations.

        Args:
            residual: (W, N, M) residuals in noise standard deviations.
            slopes: (p, W, N, M) derivatives by the parameters, in noise standard deviations.
            state_slopes: (S, W, N, M) the same by the initial states.
            nuisance_slopes: (z, W, N, M) the same by the nuisances of the logs.
            prior: (p, p) precision of the prior.
            offset: (p,) parameters minus the prior's mean.
            nuisance: (z,) nuisances of the logs.
            precision: (z,) precisions of their prior around 0.
        """
        p, states, own = len(slopes), len(state_slopes), len(nuisance)
        parts = (slopes, nuisance_slopes, state_slopes, residual[None])
        # All products of slopes and residuals at once: (W, q + S + 1, NM) times its transpose.
        rows = torch.cat([part.flatten(2) for part in parts]).transpose(0, 1)
        products = rows @ rows.mT
        q = p + own
        hpp, gp = products[:, :q, :q].sum(0), products[:, :q, -1].sum(0)
        chi2 = float((residual * residual).sum())  # the same bits whatever is beside it
        hpp[:p, :p] += prior
        gp[:p] -= prior @ offset
        penalty = float(offset @ prior @ offset)
        hpp[p:, p:] += torch.diag(precision)
        gp[p:] -= precision * nuisance
        penalty += float(precision @ nuisance**2)
        hps = products[:, :q, q : q + states].contiguous()
        hss = products[:, q : q + states, q : q + states].contiguous()
        gs = products[:, q : q + states, -1].contiguous()
        return NormalEquations(residual, chi2, chi2 + penalty, hpp, hps, hss, gp, gs)

    @property
    def finite(self) -> bool:
        """Whether all residuals and derivatives are finite."""
        parts = (self.hpp, self.hps, self.hss, self.gp, self.gs)
        return math.isfinite(self.cost) and all(bool(torch.isfinite(part).all()) for part in parts)

    def _inverse_states(self, damping: float) -> Tensor:
        """Inverse (W, S, S) of the damped curvature of the states."""
        diagonal = torch.diagonal(self.hss, dim1=-2, dim2=-1)
        blocks = self.hss + torch.diag_embed(damping * diagonal + 1e-9)
        inverse, singular = torch.linalg.inv_ex(blocks)
        if singular.any():
            # If the measurements do not distinguish two states, the step does not change their difference.
            again = torch.from_numpy(scaled_inverse(blocks.numpy()))
            inverse = torch.where((singular > 0)[:, None, None], again, inverse)
        return inverse

    def reduced(self, damping: float) -> tuple[Tensor, Tensor, Tensor]:
        """Schur complement (q, q) of the parameters, right-hand side (q,), and inverse state blocks (W, S, S)."""
        inverse = self._inverse_states(damping)
        through = self.hps @ inverse  # (W, q, S)
        matrix = self.hpp + torch.diag(damping * torch.diagonal(self.hpp))
        matrix = matrix - torch.einsum("wis,wjs->ij", through, self.hps)
        return matrix, self.gp - torch.einsum("wis,ws->i", through, self.gs), inverse

    def solve(self, damping: float, held: np.ndarray, limit: np.ndarray) -> tuple[np.ndarray, Tensor, float]:
        """Compute the damped step and its predicted decrease of the cost; some parameters have a given step.

        Args:
            damping: Relative addition to the diagonals.
            held: (p,) True for parameters whose step is given by ``limit``.
            limit: (p,) given steps.

        Returns:
            Moves of parameters and nuisances (q,), of states (W, S), predicted decrease of the cost.

        Raises:
            DivergedError: The reduced equations overflow.
        """
        matrix, right, inverse = self.reduced(damping)
        free = torch.ones(len(right), dtype=torch.bool)
        free[: len(held)] = torch.from_numpy(~held)
        move = torch.zeros_like(right)
        move[: len(held)] = torch.from_numpy(np.where(held, limit, 0.0))
        if free.any():
            scale = torch.sqrt(torch.diagonal(matrix)[free].clamp_min(1e-30))
            scaled = matrix[free][:, free] / scale[:, None] / scale
            wanted = (right - matrix @ move)[free] / scale
            if not (torch.isfinite(scaled).all() and torch.isfinite(wanted).all()):
                raise DivergedError(
                    "the reduced normal equations are not finite: the residuals of a simulation are too large"
                )
            # On a singular matrix, only NumPy's solver gives the same bits every time; torch's (gelsy) does not.
            solution = np.linalg.lstsq(scaled.numpy(), wanted.numpy(), rcond=None)[0]
            move[free] = torch.from_numpy(solution) / scale
        states = torch.einsum("wst,wt->ws", inverse, self.gs - torch.einsum("wis,i->ws", self.hps, move))
        curvature = float(move @ self.hpp @ move + torch.einsum("ws,wst,wt->", states, self.hss, states))
        curvature += 2.0 * float(torch.einsum("i,wis,ws->", move, self.hps, states))
        gain = 2.0 * float(self.gp @ move + (self.gs * states).sum()) - curvature
        return move.numpy(), states, gain
