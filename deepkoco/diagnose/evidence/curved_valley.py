"""Starts of causes that change masses and their places, where a refit has moved the robot's own parameters instead.

A load on a link moves the measurements as another mass, centre of mass and inertia of this link do, and a factor on a
mass and its moments as these do themselves. A log that tells much of what they do together leaves a valley between both
explanations that is as narrow as the log is exact, and it is curved: the motion depends on masses times distances. No
slope at the refit leads far along it. But the motion is linear in these products, and so are the loads that it needs.
The refit's information about the parameters is carried over to the loads along the log, and the cheapest point of the
valley is found there, without a simulation: the cause with parameters near their priors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.optimize import least_squares
from torch import Tensor

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.screening import StartPoint
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.prior import Prior
from deepkoco.systems.added_loads import own_values
from deepkoco.systems.effects.effect import PlacedEffect
from deepkoco.systems.motion import Motion
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.base_parameters import smooth_motion
from deepkoco.systems.trees.visible import SHOWN_OTHERWISE

STEP = 1e-5  # of finite differences, in standard deviations of the priors
# The valley is curved, and steps along a narrow one are short: the search begins in one that is wide.
SHARES = (1e-3, 1e-2, 0.1, 1.0)  # of the deviations by which the log tells the motion
EVALUATIONS = 40  # of each search
TOLERANCE = 1e-3  # relative fall of the cost below which it ends
FIRST = 0.05  # load from which a search begins, in standard deviations of its prior
BEYOND = 1.0  # where on its link, in such deviations from the centre of mass
SAMPLES = 100  # of the motion
SHORTEST = 12  # samples of a window that show an acceleration
FAINT = 1e-9  # singular value of the slopes of the loads, as a share of the largest, that is rounding
INSIDE = 1e-9  # of the bounds, at least, in such deviations
LEAST = 8.0  # fall of the penalty from which a point is worth a fit


def cheapest_in_valley(
    problem: FitProblem, reference: Fit, prior: Prior, causes: Sequence[Cause], least: float = 0.0
) -> list[StartPoint]:
    """Return starts of causes that move the measurements as the refit does and leave its parameters near their priors.

    Args:
        problem: The windows.
        reference: The refit.
        prior: Prior of its parameters.
        causes: Those of which a start is asked.
        least: Fall of the penalty that a start needs; no more than the whole penalty can fall.
    """
    base, least = problem.system.base, max(least, LEAST)
    if reference.penalty <= least or problem.nuisances.varies or not isinstance(base, TreeSystem):
        return []
    motion, found = _motion_of(problem.windows, base.joints, len(base.commands)), []
    if motion is None:
        return []
    for cause in causes:
        placed = next((e for e in problem.system.effects if e.name == cause.effect), None)
        if placed is None or placed.effect.site not in ("place", "body"):
            continue
        point = _Valley(problem, reference, prior, cause, placed, motion).cheapest(least)
        if point is not None:
            found.append(point)
    return found


class _Valley:
    """Parameters of a refit and of a cause, and what they cost where the motion stays that of the refit."""

    def __init__(
        self,
        problem: FitProblem,
        reference: Fit,
        prior: Prior,
        cause: Cause,
        placed: PlacedEffect,
        motion: tuple[tuple[Tensor, ...], ...],
    ) -> None:
        system = problem.system
        assert isinstance(system.base, TreeSystem)
        self.tree, self.motion = system.base, motion
        self.problem, self.reference, self.cause, self.placed = problem, reference, cause, placed
        # The load of an instant shows no lags of commands, nor limits that are not reached; these stay as they are.
        free = [n for n in reference.free if "." not in n and not n.startswith(SHOWN_OTHERWISE)]
        self.names = (*free, *cause.free)
        columns = [problem.names.index(n) for n in self.names]
        self.low, self.high = problem.low[columns], problem.high[columns]
        self.spread = np.array([system.parameter(n).prior_sd for n in self.names])
        pick = [reference.free.index(n) for n in free]
        self.count, own = len(free), self.spread[: len(free)]
        self.here = np.array([reference.values[n] for n in self.names])
        self.penalty = prior.penalty(free)
        self.root = _root(self.penalty.precision * np.outer(own, own))
        information = reference.information[np.ix_(pick, pick)] * np.outer(own, own)
        self.loads = np.array(system.base.load_scales)
        self.known = self._needed(self.here[None])[0]
        slopes = self._slopes(self.here, self._needed)[:, : len(free)]
        self.told = _root(information) @ np.linalg.pinv(slopes, rcond=FAINT)

    def cheapest(self, least: float) -> StartPoint | None:
        """Return the cheapest point, with the fall of the penalty as its promise; None where that is not enough.

        Where more of what the log tells counts, the cost is no lower.
        """
        low, high = self.low / self.spread, self.high / self.spread
        x, cost = self.here / self.spread, np.inf
        for k, name in enumerate(self.names):
            if name in self.cause.free:
                x[k] += BEYOND if name.endswith(".along") else FIRST
        for share in SHARES:
            found = least_squares(
                lambda x, share=share: self._left(x[None], share)[0],
                np.clip(x, low + INSIDE, high - INSIDE),
                lambda x, share=share: self._slopes_left(x, share),  # pyright: ignore[reportArgumentType]
                (low, high),
                ftol=TOLERANCE,
                max_nfev=EVALUATIONS,
            )
            x, cost = found.x, 2.0 * float(found.cost)
            if self.reference.penalty - cost <= least:
                return None
        values = dict(zip(self.names, map(float, x * self.spread), strict=True))
        return StartPoint(self.cause, values, self.reference.penalty - cost)

    def _left(self, x: np.ndarray, share: float = 1.0) -> np.ndarray:
        """Rest (L, n) of which the square is the cost of L points (L, names), with a share of what the log tells."""
        own = self.spread[: self.count]
        prior = self.penalty.offset(x[:, : self.count] * own) / own @ self.root.T
        told = share * (self._needed(x * self.spread) - self.known) @ self.told.T
        return np.concatenate([told, prior], axis=1)

    def _slopes_left(self, x: np.ndarray, share: float) -> np.ndarray:
        """Slopes (n, names) of the rest at one point."""
        return (self._left(x + STEP * np.eye(len(x)), share) - self._left(x[None], share)).T / STEP

    def _slopes(self, at: np.ndarray, of: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Slopes (K, names) by the parameters, in their standard deviations."""
        return (of(at + STEP * np.diag(self.spread)) - of(at[None])).T / STEP

    def _needed(self, points: np.ndarray) -> np.ndarray:
        """Loads (L, K) that the motion of the log needs at L points (L, names), in typical loads of their joints."""
        system = self.problem.system
        values = {n: torch.tensor(v, dtype=torch.float64) for n, v in self.reference.values.items()}
        values |= {n: torch.from_numpy(points[:, k].copy()) for k, n in enumerate(self.names)}
        for placed in system.effects:
            if placed.effect.place == "body":
                own = own_values(placed.name, values)
                null = all(bool((own[p.name] == p.value).all()) for p in placed.parameters(system.base))
                if placed is self.placed or not null:
                    values = dict(placed.effect.apply(system.base, placed.index, values, own))
        angles, speeds, accelerations, commands = self.motion
        found = self.tree.needed_loads(values)(Motion(angles, speeds, commands), accelerations)
        table = torch.stack(torch.broadcast_tensors(*found), -1).numpy()  # (n, L, J)
        return np.moveaxis(table / self.loads, 1, 0).reshape(len(points), -1)


def _motion_of(windows: Windows, joints: int, count: int) -> tuple[tuple[Tensor, ...], ...] | None:
    """Angles, speeds, accelerations and commands, each (n, 1), at some samples; None where a joint is not measured."""
    shows = list(windows.shows)
    if any(j not in shows for j in range(joints)):
        return None
    columns, parts = [shows.index(j) for j in range(joints)], []
    for w, log in enumerate(windows.log):
        commands = windows.commands[log]
        seen = windows.valid[w, columns].all(0).numpy()
        t = windows.t[w, columns[0]].numpy()[seen]
        if len(t) < SHORTEST:
            continue
        angles = windows.value[w, columns].numpy()[:, seen].T
        rows = np.clip(np.searchsorted(commands.t, windows.t0[w] + t, side="right") - 1, 0, None)
        sent = np.column_stack([commands.column(k)[rows] for k in range(count)])
        parts.append(smooth_motion(t, angles, sent))
    if not parts:
        return None
    whole = [np.concatenate(part) for part in zip(*parts, strict=True)]
    pick = np.unique(np.linspace(0, len(whole[0]) - 1, SAMPLES).astype(int))
    return tuple(tuple(torch.from_numpy(x[:, None].copy()) for x in part[pick].T) for part in whole)


def _root(matrix: np.ndarray) -> np.ndarray:
    """Return R with R^T R a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(matrix)
    return np.sqrt(np.clip(values, 0.0, None))[:, None] * vectors.T
