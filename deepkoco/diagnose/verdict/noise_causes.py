"""Noise causes (noise level, quantisation, jitter), tested on the residuals of the final model."""

from __future__ import annotations

import math

from deepkoco.diagnose.baseline import Healthy as HealthyLogs
from deepkoco.diagnose.causes import Cause, catalogue, kind_of
from deepkoco.diagnose.causes.tolerance import Healthy
from deepkoco.diagnose.diagnosis import Estimate, Evidence, Finding
from deepkoco.diagnose.evidence.how_probable import alone, listed
from deepkoco.diagnose.evidence.minor import sample_period
from deepkoco.diagnose.residuals.residuals import dispersion
from deepkoco.diagnose.residuals.scatter import Scatter
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit
from deepkoco.systems import ExtendedSystem

RUN_TO_RUN = 1.1  # ratio to which noise of one machine differs from log to log


def scatter_findings(
    system: ExtendedSystem,
    windows: Windows,
    fit: Fit,
    detection: float,
    healthy: HealthyLogs | None = None,
    floor: float = 1.0,
) -> tuple[Finding, ...]:
    """Return the noise causes whose fall of the BIC exceeds the threshold, strongest first.

    Causes within their tolerance, and causes of which the healthy logs show as much, are left out. A sensor of which
    nobody stated the noise is noisier than its healthy logs at most.

    Args:
        system: The extended system.
        windows: Training windows.
        fit: The final model on them.
        detection: Fall of the BIC from which a cause is named.
        healthy: The healthy logs and their fit; None without any.
        floor: Variance that ``windows`` count as noise, over that of the sensors.
    """
    view = Scatter(system.base, windows, fit, floor)
    usual = None if healthy is None else Scatter(system.base, healthy.windows, healthy.fit)
    deflation = dispersion(fit, windows).correlation
    found = []
    for name, cause in catalogue(system.base).items():
        if cause.scatter is None or (healthy is None and _is_a_guess(system, cause)):
            continue
        verdict = cause.scatter(view, cause.index)
        if verdict is None:
            continue
        score = verdict.likelihood_ratio / deflation - cause.size * math.log(max(windows.samples, 2))
        if score <= detection:
            continue
        placed = f"{name}.{verdict.parameter}"
        declared = system.parameter(placed)
        machine = Healthy(declared, max(system.load_scales), sample_period(windows), dict(fit.values))
        away = max(abs(verdict.low - declared.value), abs(verdict.high - declared.value))
        if away <= cause.tolerance(machine):
            continue
        known = None if usual is None else cause.scatter(usual, cause.index)
        if known is not None and verdict.low <= RUN_TO_RUN * known.high:
            continue
        text = f"With this cause, the likelihood ratio of the residuals is {verdict.likelihood_ratio:.0f}."
        evidence = Evidence("likelihood_ratio", verdict.likelihood_ratio, deflation * detection, text)
        estimate = Estimate(verdict.value, verdict.low, verdict.high, declared.unit)
        chances = alone(name, score, detection)
        own = {placed: estimate}
        found.append(
            Finding(
                name,
                cause.family,
                (name,),
                score,
                chances[name],
                own,
                (evidence,),
                probabilities=listed(chances),
            )
        )
    if any(kind_of(f.name) == "jitter" for f in found):
        # Jitter already explains why the channels are noisier than their data sheets say.
        found = [f for f in found if kind_of(f.name) != "noise_level"]
    return tuple(sorted(found, key=lambda f: -f.delta_bic))


def _is_a_guess(system: ExtendedSystem, cause: Cause) -> bool:
    """Whether a cause compares the noise of a sensor with what nobody stated."""
    return cause.kind == "noise_level" and system.measurements[cause.index].guessed
