"""One step of a system by the classical Runge-Kutta method."""

from __future__ import annotations

from torch import Tensor

from deepkoco.systems.parameter import Parameters
from deepkoco.systems.system import System


def rk4_step(
    system: System, state: Tensor, effort: Tensor, dt: Tensor | float, parameters: Parameters
) -> Tensor:
    """One step of the classical Runge-Kutta method under a constant effort.

    Args:
        system: Dynamics.
        state: (..., S).
        effort: (..., M), for one joint (...), held over the step.
        dt: Step [s], scalar or (...).
        parameters: Named values, each scalar or (...).

    Returns:
        State (..., S) after ``dt``.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.1.
    """
    h = dt.unsqueeze(-1) if isinstance(dt, Tensor) and dt.ndim > 0 else dt
    k1 = system.derivative(state, effort, parameters)
    k2 = system.derivative(state + 0.5 * h * k1, effort, parameters)
    k3 = system.derivative(state + 0.5 * h * k2, effort, parameters)
    k4 = system.derivative(state + h * k3, effort, parameters)
    return state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
