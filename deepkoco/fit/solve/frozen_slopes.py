"""Slopes of the measurements at one point, kept for fits that do not go far from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.shooting import ShootingProblem
from deepkoco.fit.solve.normal_equations import NormalEquations
from deepkoco.fit.tangent import Tangent


@dataclass(frozen=True)
class FrozenSlopes:
    """Whitened slopes by parameters, nuisances of the logs and initial states at one point, and their products.

    Attributes:
        names: The q parameters.
        rows: (q + z, W, NM) slopes by the parameters, then by the nuisances.
        states: (W, NM, S) slopes by the initial states.
        hpp: (q + z, q + z) products of the rows.
        hps: (W, q + z, S) products of rows and states.
        hss: (W, S, S) products of the states.
    """

    names: tuple[str, ...]
    rows: Tensor
    states: Tensor
    hpp: Tensor
    hps: Tensor
    hss: Tensor

    @staticmethod
    def of(names: Sequence[str], rows: Tensor, states: Tensor) -> FrozenSlopes:
        """Return slopes with their products.

        Args:
            names: The q parameters.
            rows: (q + z, W, N, M) slopes by parameters and nuisances.
            states: (S, W, N, M) slopes by the initial states.
        """
        flat, own = rows.flatten(2), states.flatten(2).permute(1, 2, 0).contiguous()
        whole = flat.flatten(1)
        across = torch.bmm(flat.permute(1, 0, 2), own)
        return FrozenSlopes(tuple(names), flat, own, whole @ whole.T, across, own.mT @ own)

    def replaced(self, names: Sequence[str], slopes: Tensor) -> FrozenSlopes:
        """Return slopes of which some are new.

        Args:
            names: Parameters with new slopes.
            slopes: (c + S, W, N, M) new slopes by these parameters, then by the initial states.
        """
        rows = self.rows.clone()
        rows[[self.names.index(n) for n in names]] = slopes[: len(names)].flatten(2)
        return FrozenSlopes.of(self.names, rows[..., None], slopes[len(names) :])

    def after(self, moved: Tensor, states: Tensor, missed: Tensor) -> FrozenSlopes:
        """Return slopes that also predict a step that was simulated (Broyden's update, window by window).

        Args:
            moved: (q + z,) step of the parameters and nuisances in units of their scales, divided by these scales.
            states: (W, S) the same of the initial states.
            missed: (W, NM) change of the measurements that these slopes did not predict, over the sum of the squared
                steps in units of the scales, in each window.
        """
        rows = self.rows + moved[:, None, None] * missed
        own = self.states + missed[..., None] * states[:, None, :]
        whole = rows.flatten(1)
        return FrozenSlopes(
            self.names, rows, own, whole @ whole.T, torch.bmm(rows.permute(1, 0, 2), own), own.mT @ own
        )

    def equations(
        self,
        problem: ShootingProblem,
        free: Sequence[str],
        fresh: dict[str, Tensor],
        residual: Tensor,
        prior: Tensor,
        offset: Tensor,
        nuisance: Tensor,
    ) -> NormalEquations:
        """Return the normal equations of a trial whose slopes are these, except for some that are given.

        Args:
            problem: The problem.
            free: The p parameters of the trial, each of these slopes or of ``fresh``.
            fresh: Parameter -> slopes (W, N, M) that are taken instead.
            residual: (W, N, M) residuals in noise standard deviations.
            prior, offset, nuisance: As for :meth:`.NormalEquations.build`.
        """
        p, q, z = len(free), len(self.names), len(nuisance)
        old = [i for i, n in enumerate(free) if n not in fresh] + list(range(p, p + z))
        take = [self.names.index(n) for n in free if n not in fresh] + list(range(q, q + z))
        new = [i for i, n in enumerate(free) if n in fresh]
        r = residual.flatten(1)
        hpp = torch.zeros(p + z, p + z, dtype=torch.float64)
        hps = torch.zeros(len(r), p + z, self.states.shape[2], dtype=torch.float64)
        gp = torch.zeros(p + z, dtype=torch.float64)
        hpp[np.ix_(old, old)] = self.hpp[np.ix_(take, take)]
        hps[:, old] = self.hps[:, take]
        gp[old] = (self.rows.flatten(1) @ r.flatten())[take]
        if new:
            own = torch.stack([fresh[free[i]] for i in new]).flatten(2)
            across = own.flatten(1) @ self.rows.flatten(1).T
            hpp[np.ix_(new, old)] = across[:, take]
            hpp[np.ix_(old, new)] = across[:, take].T
            hpp[np.ix_(new, new)] = own.flatten(1) @ own.flatten(1).T
            hps[:, new] = torch.bmm(own.permute(1, 0, 2), self.states)
            gp[new] = own.flatten(1) @ r.flatten()
        precision = problem.nuisances.precision
        hpp[:p, :p] += prior
        hpp[p:, p:] += torch.diag(precision)
        gp[:p] -= prior @ offset
        gp[p:] -= precision * nuisance
        chi2 = float((r * r).sum())
        penalty = float(offset @ prior @ offset) + float(precision @ nuisance**2)
        gs = torch.bmm(self.states.mT, r[..., None])[..., 0]
        return NormalEquations(residual, chi2, chi2 + penalty, hpp, hps, self.hss, gp, gs)


def varying(problem: ShootingProblem, names: Sequence[str]) -> list[str]:
    """Return the parameters that vary from log to log and are not among these."""
    return [n for n in problem.nuisances.varies if n not in names]


def slopes_at(
    problem: ShootingProblem, tangent: Tangent, lanes: Tensor, names: Sequence[str]
) -> FrozenSlopes:
    """Return the slopes that simulated lanes show.

    Args:
        problem: The problem.
        tangent: The lanes: ``names``, then those of :func:`varying`, then the initial states.
        lanes: (1 + q + v + S, W, N, M) their measurements.
        names: The q parameters.
    """
    slopes = tangent.slopes(lanes, problem)
    moved = [*names, *varying(problem, names)]
    of_varying = slopes[[moved.index(n) for n in problem.nuisances.varies]]
    rows = torch.cat([slopes[: len(names)], problem.nuisance_slopes(of_varying)])
    return FrozenSlopes.of(names, rows, slopes[len(moved) :])
