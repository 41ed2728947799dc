"""What a named cause amounts to in the simulation's own parameters, and what speaks for it besides their priors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.diagnosis import Estimate, Evidence, Moved
from deepkoco.diagnose.evidence.absorbed import alike
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.deflated import deflated

MOST_LISTED = 3  # parameters of the refit that a sentence lists
NOTABLE = 2.0  # standard deviations of the prior from which it lists one


def same_parameter(
    problem: FitProblem,
    cause: Cause,
    fit: Fit,
    given: Mapping[str, float],
    deflation: float,
    narrowed: float,
) -> tuple[Moved, ...]:
    """Return the parameters of the simulation that would do exactly the same as a cause; usually none.

    A payload at the tip is the same as a heavier tip. Such a parameter has the unit of the cause's own, and the
    simulation with their sum, without the cause, gives the same measurements.

    Args:
        problem: The windows.
        cause: The cause.
        fit: Fit with it.
        given: Values of the baseline.
        deflation: Deflation of the residuals.
        narrowed: Factor by which the prior is narrower than it was stated; see :func:`.deflated`.
    """
    found, c = [], deflated(fit, deflation, narrowed * fit.narrowed)
    for name, value in alike(problem, fit, cause, given).items():
        p, i, j = problem.system.parameter(name), fit.free.index(cause.free[0]), fit.free.index(name)
        reach = 1.96 * float(np.sqrt(max(c[i, i] + c[j, j] + 2.0 * c[i, j], 0.0)))
        before = given[name]
        found.append(
            Moved(
                name,
                before,
                Estimate(value, max(value - reach, p.low), min(value + reach, p.high), p.unit),
                abs(value - before) / p.prior_sd,
            )
        )
    return tuple(found)


def evidence_of_priors(
    reference: Fit, fit: Fit, priors: Mapping[str, tuple[float, float]], learned: bool
) -> tuple[Evidence, ...]:
    """Return a sentence if the refit explains the log as well as the cause does, by parameters far from their priors.

    Args:
        reference: The refit.
        fit: Fit with the cause.
        priors: Parameter -> (mean, standard deviation).
        learned: Whether the priors were learned from healthy logs.
    """
    saved = reference.cost - fit.cost
    share = (reference.chi2 - fit.chi2) / saved if saved > 0.0 else 1.0
    if share >= 0.5:
        return ()
    away = {n: abs(reference.values[n] - m) / s for n, (m, s) in priors.items() if n in reference.values}
    far = sorted((n for n, sds in away.items() if sds > NOTABLE), key=lambda n: -away[n])[:MOST_LISTED]
    if not far:
        return ()
    listed = ", ".join(f"{n} = {reference.values[n]:.4g} instead of {priors[n][0]:.4g}" for n in far)
    why = "values that the healthy logs gave" if learned else "spread that is declared for these parameters"
    text = (
        f"A refit explains the log as well without this cause, with {listed}. Only the {why} "
        f"{'speak' if learned else 'speaks'} for the cause."
    )
    return (Evidence("prior_share", 1.0 - share, 0.5, text),)
