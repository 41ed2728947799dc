"""The small dense quadratic program in the actions that both condensed forms end in."""

from __future__ import annotations

import numpy as np

from deepkoco.planning.config import Array, PlanningProblem
from deepkoco.planning.program import estimated_condition, shifted
from deepkoco.planning.refinement import Refinement
from deepkoco.planning.solvers import make_box_solver


class BoxProgram:
    r"""min over $a_{min} \le a_1 \dots a_H \le a_{max}$ of
    $|y_0 + D a|^2 + a^\top R a + \Delta a^\top \tilde R \Delta a$ with diagonal R and $\tilde R$.

    What a condensed form adds is how D and y_0 follow from its model. Written in the actions instead of the
    increments the limits are plain bounds; the two programs are one linear change of variables apart. A
    solution that is not certain to be within 1e-4 of the action range is replaced by the exact one, see
    `Refinement`.

    Attributes:
        refined: Whether the last solution was replaced.

    Source: DeepKoCo, Eq. 5.16.
    """

    def __init__(
        self, problem: PlanningProblem, solver: str, tolerance: float, warm_start: str = "kept"
    ) -> None:
        """Make everything that does not change from step to step.

        Args:
            problem: Dynamics, weights and limits.
            solver: Name of the solver.
            tolerance: For solvers that iterate.
            warm_start: "kept", "shifted" or "none", see `PlannerConfig`.

        Raises:
            UnknownSolverError: No such solver is installed.
        """
        steps, actions = problem.horizon, problem.action_low.size
        self._problem = problem
        difference = np.kron(np.eye(steps) - np.eye(steps, k=-1), np.eye(actions))
        fixed = problem.increment_weights * difference.T @ difference
        self._fixed = np.asarray(2.0 * (np.diag(problem.action_weights) + fixed), np.float64)
        low, high = np.tile(problem.action_low, steps), np.tile(problem.action_high, steps)
        self._solver = make_box_solver(solver, low, high, tolerance)
        self._refinement = Refinement(problem, self._fixed)
        self.refined = False
        self._warm_start = warm_start
        self._planned: Array | None = None
        self._response = np.zeros((1, steps * actions)), np.zeros(1)
        self._hessian = self._fixed

    @property
    def iterations(self) -> int:
        """Of the last solve."""
        return self._solver.iterations

    def reset(self) -> None:
        """Begin the next solve as a new program would."""
        self._planned = None
        self._solver.restart()

    def quadratic(self, matrix: Array, free: Array, action: Array) -> tuple[Array, Array]:
        """The quadratic program.

        Args:
            matrix: D (r H, H M).
            free: y_0 (r H,).
            action: Present action a_0 (M,).

        Returns:
            Hessian (HM, HM) and gradient (HM,) for the stacked actions a_1 .. a_H.
        """
        hessian = 2.0 * (matrix.T @ matrix)
        hessian += self._fixed
        gradient = 2.0 * (free @ matrix)
        gradient[: action.size] -= 2.0 * self._problem.increment_weight * action
        return hessian, gradient

    def solve_box(self, matrix: Array, free: Array, action: Array) -> Array:
        """Plan; see `quadratic` for the arguments.

        Returns:
            Planned actions a_1 .. a_H (H, M).

        Raises:
            SolverError: The program was not solved.
        """
        self._response = matrix, free
        self._hessian, gradient = self.quadratic(matrix, free, action)
        if self._warm_start == "none":
            self._solver.restart()
        elif self._warm_start == "shifted" and self._planned is not None:
            self._solver.start_at(shifted(self._planned).ravel())
        self.refined = False
        solution = self._solver.solve(self._hessian, gradient)
        exact = self._solver.exact and self._refinement.is_well_conditioned(self._hessian)
        if not exact and not self._refinement.is_close(solution, matrix, free, action):
            solution, self.refined = self._refinement.solve(solution, matrix, free, action), True
        self._planned = solution.reshape(self._problem.horizon, -1)
        return self._planned

    def planned_cost(self, planned: Array) -> float:
        """See `Program.planned_cost`."""
        matrix, free = self._response
        y, flat = free + matrix @ planned.ravel(), planned.ravel()
        return float(y @ y + self._problem.action_weights * flat @ flat)

    def conditioning(self) -> float:
        """See `Program.conditioning`."""
        return estimated_condition(self._hessian)
