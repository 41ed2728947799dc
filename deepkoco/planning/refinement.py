"""How far a plan can be from the optimum, and the exact optimum where that is too far."""

from __future__ import annotations

import numpy as np
from scipy.linalg import get_lapack_funcs

from deepkoco.planning.config import Array, PlanningProblem
from deepkoco.planning.errors import SolverError

PRECISION = 1e-4
"""Largest distance of a plan from the optimum that is let pass, as a share of the smallest action range."""
COST_PRECISION = 1e-6
"""Where R and R~ are zero: largest excess of a plan's cost over the optimum that is let pass, as a share of the cost
|y_0|^2 of zero actions."""
NEAR = 1e-6
"""An action this close to a limit is taken to lie at it, as a share of its range."""
WELL_CONDITIONED = 1e6
"""Bound on the condition number of the Hessian up to which rounding leaves no error near `PRECISION`."""
ROUNDING = 1e-15
"""Cosine of the angle between a column and the residual below which the column is taken to be orthogonal."""
NO_SLOPE = 1e-12
"""Share of its largest possible value, |D_i| (|y_0| + sum |D_j x_j|), below which a slope of the cost is rounding."""
ROUNDS = 10
"""Changes of the set of limits that are active, per action, before the search is given up."""

(_LEAST_SQUARES,) = get_lapack_funcs(("gels",), dtype=np.float64)


class Refinement:
    r"""Checks and mends solutions of min $f(x) = |y_0 + D x|^2 + R |x|^2 + \tilde R |\Delta x|^2$ in a box.

    The Hessian of $f$ is at least that of its last two terms, whose smallest eigenvalue $\mu$ is known
    beforehand. Let $v$ be the gradient at $x$ without the components that push against an active limit. Then
    $|x - x^*| \le |v| / \mu$ for every $x$ in the box. A solver that stops at a tolerance relative to the
    gradient leaves a large $|v| / \mu$ where D is large, which is where the Hessian is ill-conditioned.

    The mended solution comes from a least-squares problem by QR, whose condition number is the square root of the
    Hessian's. The normal equations $D^\top D$, which every solver is given, lose twice as many digits.

    Where R and R~ are zero, $\mu$ is zero and several plans may be optimal. The cost is bounded instead: f is convex,
    so $f(x) - f(x^*) \le \max_z \nabla f(x)^\top (x - z)$ over all z in the box.

    Source: Nesterov, Lectures on convex optimization, 2018, section 2.1 (strong convexity); Stark and Parker,
    Bounded-variable least-squares: an algorithm and applications, Computational Statistics 1995; Jaggi, Revisiting
    Frank-Wolfe, ICML 2013, section 2 (bound on the cost).
    """

    def __init__(self, problem: PlanningProblem, fixed: Array) -> None:
        """Prepare what does not change from step to step.

        Args:
            problem: Weights and limits.
            fixed: Hessian (H M, H M) of the last two terms of f.
        """
        steps, actions = problem.horizon, problem.action_low.size
        self._fixed, self._problem = fixed, problem
        self._low, self._high = np.tile(problem.action_low, steps), np.tile(problem.action_high, steps)
        spans = self._high - self._low
        spans[~np.isfinite(spans)] = 1.0
        self._near = NEAR * spans
        self._allowed = PRECISION * float(spans.min())
        self._convexity = float(np.linalg.eigvalsh(fixed)[0])
        difference = np.kron(np.eye(steps) - np.eye(steps, k=-1), np.eye(actions))
        self._weights = np.vstack(
            (np.diag(problem.action_weights**0.5), problem.increment_weights[:, None] ** 0.5 * difference)
        )

    def is_well_conditioned(self, hessian: Array) -> bool:
        """Tell whether an upper bound on the Hessian's (H M, H M) condition number is small: trace / mu."""
        return float(hessian.trace()) <= WELL_CONDITIONED * self._convexity

    def is_close(self, x: Array, matrix: Array, free: Array, action: Array) -> bool:
        """Tell whether a solution is certain to lie within `PRECISION` of the optimum.

        Args:
            x: Solution (H M,).
            matrix: D (r H, H M).
            free: y_0 (r H,).
            action: Present action a_0 (M,).

        Returns:
            Whether it does; where R and R~ are zero, whether its cost is certain to be within `COST_PRECISION`.
        """
        if self._convexity <= 0.0:
            return self._is_cheap(x, matrix, free)
        at_low, at_high = x <= self._low + self._near, x >= self._high - self._near
        x = np.where(at_low, self._low, np.where(at_high, self._high, x))
        gradient = 2.0 * ((free + matrix @ x) @ matrix) + self._fixed @ x
        gradient[: action.size] -= 2.0 * self._problem.increment_weight * action
        gradient[at_low & (gradient > 0.0) | at_high & (gradient < 0.0)] = 0.0
        return float(gradient @ gradient) <= (self._convexity * self._allowed) ** 2

    def _is_cheap(self, x: Array, matrix: Array, free: Array) -> bool:
        """Tell whether the cost |y_0 + D x|^2 of a plan in the box is certain to be near the lowest one."""
        if ((x < self._low - self._near) | (x > self._high + self._near)).any():
            return False
        x = np.minimum(np.maximum(x, self._low), self._high)
        residual = free + matrix @ x
        slope = 2.0 * (residual @ matrix)
        columns = np.sqrt((matrix * matrix).sum(0))
        most = 2.0 * columns * (np.linalg.norm(free) + columns @ np.abs(x))
        slope[np.abs(slope) <= NO_SLOPE * most] = 0.0
        # Moving an action to the limit at which the linearised cost is lowest; infinite where it has no limit.
        room = np.where(slope > 0.0, x - self._low, self._high - x)
        falls = slope != 0.0
        excess = float(np.abs(slope[falls]) @ room[falls])
        return excess <= COST_PRECISION * float(free @ free)

    def solve(self, x: Array, matrix: Array, free: Array, action: Array) -> Array:
        """Find the optimum from a solution nearby; arguments as in `is_close`.

        Returns:
            Optimum (H M,).

        Raises:
            SolverError: The set of active limits was not found, or (where R and R~ are zero) the cost of what was
                found is not certain to be near the lowest one.
        """
        stacked = np.vstack((matrix, self._weights))
        right = np.zeros(len(stacked))
        right[: free.size] = -free
        right[free.size + x.size : free.size + x.size + action.size] = (
            self._problem.increment_weight**0.5 * action
        )
        unique = self._convexity > 0.0
        found = bounded_least_squares(stacked, right, self._low, self._high, x, self._near, unique)
        if not unique and not self._is_cheap(found, matrix, free):
            raise SolverError(
                "the plan may be far from the optimum: R and R~ are zero and its matrix is ill-conditioned; give "
                "planner.increment_weight above 0"
            )
        return found


def bounded_least_squares(
    matrix: Array, right: Array, low: Array, high: Array, start: Array, near: Array, unique: bool = True
) -> Array:
    """Minimise |A x - b|^2 subject to low <= x <= high by an active-set method.

    Args:
        matrix: A (m, n).
        right: b (m,).
        low: (n,).
        high: (n,).
        start: Any x (n,); its components near a limit begin there.
        near: Distance from a limit that counts as near (n,).
        unique: Whether A must have full column rank; otherwise one of several solutions is taken.

    Returns:
        Solution (n,).

    Raises:
        SolverError: The active limits were not found, or A has not full column rank though it must.

    Source: Stark and Parker, Computational Statistics 1995; scipy's `lsq_linear` has the same method without a
    start.
    """
    x = np.minimum(np.maximum(start, low), high)
    side = np.where(x <= low + near, -1, np.where(x >= high - near, 1, 0))  # 0: between the limits
    x = np.where(side < 0, low, np.where(side > 0, high, x))
    norms = np.maximum(np.sqrt((matrix * matrix).sum(0)), np.finfo(np.float64).tiny)
    refused = np.zeros(x.size, bool)  # freed once at this x, and pushed back by rounding
    freed, came_from = -1, 0
    for _ in range(ROUNDS * x.size):
        between = np.flatnonzero(side == 0)
        target = x.copy()
        wanted = right - matrix @ np.where(side == 0, 0.0, x)
        target[between] = _least_squares(matrix[:, between], wanted, unique)
        if freed >= 0 and (target[freed] - x[freed]) * came_from > 0:
            side[freed], refused[freed], freed = came_from, True, -1
            continue
        freed = -1
        beyond = between[(target[between] < low[between]) | (target[between] > high[between])]
        if beyond.size:
            limits = np.where(target < low, low, high)
            shares = (limits[beyond] - x[beyond]) / (target[beyond] - x[beyond])
            first = beyond[shares.argmin()]
            side[first] = -1 if target[first] < low[first] else 1
            x[between] += shares.min() * (target[between] - x[between])
            x = np.minimum(np.maximum(x, low), high)
            x[first] = limits[first]
            refused[:] = False
            continue
        x = target
        residual = right - matrix @ x
        # Positive where leaving the limit lowers the sum of squares.
        gain = -side * (residual @ matrix) / norms / max(float(np.linalg.norm(residual)), 1e-300)
        gain[refused] = 0.0
        freed = int(gain.argmax())
        if gain[freed] <= ROUNDING:
            return x
        came_from, side[freed] = int(side[freed]), 0
    raise SolverError("the active limits of an ill-conditioned plan were not found")


def _least_squares(matrix: Array, right: Array, unique: bool) -> Array:
    """Solve by QR, or take the smallest of several solutions."""
    count = matrix.shape[1]
    if count == 0:
        return np.zeros(0)
    if not unique:
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0], dtype=np.float64)
    _, solution, failed = _LEAST_SQUARES(matrix, right)
    if failed:
        raise SolverError("the plan is not unique: its least-squares problem is singular")
    return solution[:count]
