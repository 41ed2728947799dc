"""Settings and limits of the planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepkoco.koopman.latent_model import LatentDynamics
from deepkoco.planning.errors import PlannerConfigError
from deepkoco.planning.solvers import check_solver

Array = NDArray[np.float64]
CHOICES = {
    "method": ("lmpc", "cem"),
    "form": ("condensed", "sparse"),
    "linearisation": ("frozen", "cost_along_plan", "along_plan", "tangent"),
    "warm_start": ("kept", "shifted", "none"),
}


@dataclass
class PlannerConfig:
    """Settings of the planner."""

    horizon: int = 13
    """H, planned steps; a little less than the training horizon T, see docs/training.md."""
    increment_weight: float = 0.01
    """R~, weight of a squared action increment."""
    increment_units: tuple[float, ...] = ()
    """Unit of each action in which R~ weighs its increments, for actions of unlike ranges; empty: 1 for all."""
    form: str = "condensed"
    """How the quadratic program is written: "condensed" (actions only) or "sparse" (latents too)."""
    solver: str = "auto"
    """Solver of the quadratic program: "auto" (daqp condensed, osqp sparse), "daqp" (condensed only), "osqp",
    "piqp" (needs the extra solvers) or any other installed solver of qpsolvers."""
    tolerance: float = 1e-6
    """Absolute and relative tolerance of osqp and piqp."""
    method: str = "lmpc"
    """How a plan is found: "lmpc", one quadratic program per step, or "cem", the cross-entropy method on
    the same latent model."""
    linearisation: str = "frozen"
    """B and C over a plan: "frozen" at the present state; "cost_along_plan": C taken anew at the predicted
    latents; "along_plan": C and B, which needs a model with a decoder (agent.rollout=updated); "tangent": B
    and the slope of C s. The quadratic programs take the latents of the last plan, cem those of every sample."""
    warm_start: str = "kept"
    """Where a solver begins: "kept": its own last solution; "shifted": the last plan moved on by one step;
    "none": from scratch."""
    samples: int = 500
    """Action sequences per iteration of cem."""
    sample_iterations: int = 5
    """Iterations of cem per decision."""
    elites: int = 50
    """Best sequences that cem fits its next distribution to."""

    @property
    def increment_weights(self) -> float | Array:
        """R~, one for all actions or one each (M,)."""
        if not self.increment_units:
            return self.increment_weight
        return self.increment_weight / np.square(np.array(self.increment_units, np.float64))

    def check(self, trained_horizon: int | None = None) -> None:
        """Check the settings.

        Args:
            trained_horizon: T of the training; plans are no longer than that, for modes may grow. None
                leaves this out.

        Raises:
            PlannerConfigError: Names the first setting that is out of range and its remedy.
            UnknownSolverError: The solver is not installed, or cannot solve the form.
        """
        for name in ("horizon", "samples", "sample_iterations"):
            if getattr(self, name) < 1:
                raise PlannerConfigError(f"planner.{name} = {getattr(self, name)}; give at least 1")
        if trained_horizon is not None and self.horizon > trained_horizon:
            raise PlannerConfigError(
                f"planner.horizon = {self.horizon} exceeds the training horizon {trained_horizon}; "
                f"give at most {trained_horizon} steps or train with a larger horizon"
            )
        if not 2 <= self.elites <= self.samples:
            raise PlannerConfigError(
                f"planner.elites = {self.elites}; give 2 to planner.samples = {self.samples}"
            )
        if not 0 <= self.increment_weight < np.inf:
            raise PlannerConfigError(f"planner.increment_weight = {self.increment_weight}; give 0 or more")
        if not all(0 < unit < np.inf for unit in self.increment_units):
            raise PlannerConfigError(
                f"planner.increment_units = {list(self.increment_units)}; give numbers above 0"
            )
        if not 0 < self.tolerance < np.inf:
            raise PlannerConfigError(f"planner.tolerance = {self.tolerance}; give a value above 0")
        for name, choices in CHOICES.items():
            if getattr(self, name) not in choices:
                raise PlannerConfigError(
                    f'planner.{name} = "{getattr(self, name)}"; choose one of {", ".join(choices)}'
                )
        if self.method == "lmpc":
            check_solver(self.solver, self.form)


@dataclass(frozen=True)
class PlanningProblem:
    """What stays fixed in a control loop: dynamics, weights and limits.

    Attributes:
        dynamics: A of the free motion s' = A s, for one step.
        action_low: a_min (M,).
        action_high: a_max (M,).
        action_weight: R, one for all actions or one each (M,).
        increment_weight: R~, likewise.
        horizon: H.
        cost_rank: r, rows of the cost factor.
    """

    dynamics: LatentDynamics
    action_low: Array
    action_high: Array
    action_weight: float | Array
    increment_weight: float | Array
    horizon: int
    cost_rank: int = 1

    @property
    def action_weights(self) -> Array:
        """R of each planned action (H M,)."""
        return np.tile(np.broadcast_to(self.action_weight, self.action_low.shape), self.horizon)

    @property
    def increment_weights(self) -> Array:
        """R~ of each planned increment (H M,)."""
        return np.tile(np.broadcast_to(self.increment_weight, self.action_low.shape), self.horizon)
