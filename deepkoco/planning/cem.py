"""The cross-entropy method on the latent model: planning by samples, without convexity."""

from __future__ import annotations

import numpy as np

from deepkoco.koopman.latent_model import LatentModel
from deepkoco.planning.config import Array, PlannerConfig, PlanningProblem
from deepkoco.planning.errors import SolverError
from deepkoco.planning.program import check_decoder, shifted

SMALLEST_SPREAD = 1e-3
"""Of the sampling distribution, as a share of the actions' range: a spread of zero could not recover."""


class CrossEntropyMethod:
    r"""min of $\sum_{k=1}^H |C_k s_k|^2 + R |a_k|^2 + \tilde R |\Delta a_{k-1}|^2$ over samples.

    With frozen B and C this is the problem of the quadratic programs; else $C_k = \psi(s_k)$, and $B_k =
    \partial\varphi/\partial a$ where there is a decoder, are those of each sample's own latents. Every
    iteration draws action sequences from independent normal distributions, clips them to the limits and
    fits the distributions to the best of them. The mean of the last step's elites, moved on by one step,
    is where the next one begins, and the best sequence of all is the plan.

    Source: Rubinstein, The cross-entropy method for combinatorial and continuous optimization, 1999; as a
    planner on latent models e.g. Hafner et al., PlaNet, ICML 2019.

    Attributes:
        iterations: Of every solve.
        refined: False; see `Program.refined`.
    """

    refined = False

    def __init__(
        self,
        model: LatentModel,
        problem: PlanningProblem,
        config: PlannerConfig,
        generator: np.random.Generator,
    ) -> None:
        """Keep the settings.

        Args:
            model: Gives psi, and B along a sample.
            problem: Dynamics, weights and limits.
            config: Numbers of samples, iterations and elites.
            generator: Draws the samples.

        Raises:
            PlannerConfigError: B is asked for along the samples and the model has no decoder.
        """
        self._model, self._problem, self._generator = model, problem, generator
        self._frozen = config.linearisation == "frozen"
        self._decodable = check_decoder(model) if config.linearisation in ("along_plan", "tangent") else None
        self._samples, self._elites = config.samples, config.elites
        self.iterations = config.sample_iterations
        self._kept = config.warm_start != "none"
        self._spread = (problem.action_high - problem.action_low) / 2.0
        self._mean: Array | None = None
        size = problem.dynamics.latent_size
        self._state = np.zeros((2, size)), np.zeros((1, size)), np.zeros(1)

    def reset(self) -> None:
        """See `Program.reset`; the generator goes on."""
        self._mean = None

    def solve(self, rows: Array, factor: Array, action: Array) -> Array:
        """See `Program.solve`."""
        problem = self._problem
        if not (np.isfinite(rows).all() and np.isfinite(factor).all() and np.isfinite(action).all()):
            raise SolverError("cem: the problem has entries that are not finite")
        self._state = rows, factor, action
        shape = (self._samples, problem.horizon, action.size)
        mean = np.tile(action, (problem.horizon, 1))
        if self._kept and self._mean is not None:
            mean = shifted(self._mean)
        self._mean = None
        spread = np.broadcast_to(self._spread, mean.shape)
        best, lowest = mean, np.inf
        for _ in range(self.iterations):
            drawn = mean + spread * self._generator.standard_normal(shape)
            plans = np.minimum(np.maximum(drawn, problem.action_low), problem.action_high)
            plans[0] = np.minimum(np.maximum(mean, problem.action_low), problem.action_high)
            costs = self.objective(plans)
            order = np.argpartition(costs, self._elites - 1)[: self._elites]
            elites = plans[order]
            mean, spread = elites.mean(0), np.maximum(elites.std(0), SMALLEST_SPREAD * self._spread)
            first = order[costs[order].argmin()]
            if costs[first] < lowest:
                best, lowest = plans[first], costs[first]
        if not np.isfinite(lowest):
            raise SolverError("cem: no sample has a finite cost")
        self._mean = mean
        return best

    def objective(self, plans: Array) -> Array:
        """What is minimised.

        Args:
            plans: a_1 .. a_H of each sample (S, H, M).

        Returns:
            Costs with R~ (S,); infinity where they are not finite.
        """
        before = np.broadcast_to(self._state[2], (len(plans), 1, plans.shape[2]))
        increments = np.diff(plans, axis=1, prepend=before)
        with np.errstate(over="ignore", invalid="ignore"):
            costs = self._stage_costs(plans, increments)
        costs += np.einsum("skm,skm->s", self._problem.increment_weight * increments, increments)
        return np.where(np.isfinite(costs), costs, np.inf)

    def planned_cost(self, planned: Array) -> float:
        """See `Program.planned_cost`."""
        increments = np.diff(planned, axis=0, prepend=self._state[2][None])
        return float(self._stage_costs(planned[None], increments[None])[0])

    def conditioning(self) -> float:
        """NaN: there is no Hessian."""
        return float("nan")

    def _stage_costs(self, plans: Array, increments: Array) -> Array:
        """Sums of |C_k s_k|^2 + R a_k'a_k (S,)."""
        (rows, factor, _), problem = self._state, self._problem
        latent, inputs = np.broadcast_to(rows[0], (len(plans), rows.shape[1])), rows[1:]
        latents = np.empty((problem.horizon, *latent.shape))
        for k in range(problem.horizon):
            latent = problem.dynamics.advance(latent) + (increments[:, k, None] @ inputs)[:, 0]
            latents[k] = latent
            if self._decodable is not None and k + 1 < problem.horizon:
                inputs, _ = self._decodable.linearise_along(latent, plans[:, k])
        factors = factor if self._frozen else self._model.factor(latents)
        y = (factors @ latents[..., None])[..., 0]
        return np.einsum("ksr,ksr->s", y, y) + np.einsum("skm,skm->s", problem.action_weight * plans, plans)
