"""Result of a fit: estimates with intervals, combinations that are not identified, convergence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from deepkoco.fit.fit_types import Fit
from deepkoco.fit.request import FitRequest
from deepkoco.fit.solve.dispersion import Dispersion
from deepkoco.fit.solve.gauges import Gauge, scale_gauges
from deepkoco.fit.solve.identifiability import Direction
from deepkoco.systems import ExtendedSystem

NORMAL_95 = 1.959964


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter.

    Attributes:
        name: Name of the parameter.
        value: Maximum of the posterior.
        low: Lower end of the 95 % interval, cut at the bounds.
        high: Upper end, cut at the bounds.
        sd: Standard deviation, not cut at the bounds.
        unit: SI unit.
        start: Value before the fit.
        bounds: Lowest and highest value of the fit.
    """

    name: str
    value: float
    low: float
    high: float
    sd: float
    unit: str
    start: float
    bounds: tuple[float, float]

    @property
    def at_bound(self) -> bool:
        """Whether the value lies on or beyond a bound; the interval is then not reliable."""
        reach = 1e-9 * (self.bounds[1] - self.bounds[0])
        return self.value <= self.bounds[0] + reach or self.value >= self.bounds[1] - reach


@dataclass(frozen=True)
class Convergence:
    """Course of a fit.

    Attributes:
        method: Name of the method.
        converged: Whether the method stopped by its tolerance, not at a limit.
        reason: Why it stopped, in words.
        stages: Name of a stage, and the cost (chi2 plus prior penalty) of each of its iterations. Costs of
            different stages cannot be compared: windows and noise differ.
        simulations: Number of times that all windows were simulated.
        seconds: Wall-clock time.
    """

    method: str
    converged: bool
    reason: str
    stages: tuple[tuple[str, tuple[float, ...]], ...]
    simulations: int
    seconds: float


@dataclass(frozen=True)
class Identification:
    """Parameters of a system, fitted to recordings.

    Attributes:
        system: The system with the fitted values, to simulate, save or diagnose.
        estimates: Fitted parameters by name. Their intervals are widened by ``dispersion.deflation``.
        zeros: Encoder zeros of each log; empty if the sensors' zeros are known.
        of_logs: Values of single logs, for parameters that vary; empty if none varies.
        covariance: (p, p) of the free parameters, in the order of ``estimates``, widened like the intervals.
        unidentified: Combinations about which the data contain less information than the prior.
        dispersion: Size and autocorrelation of the residuals, relative to white sensor noise.
        convergence: Course of the fit.
        request: The request, with the noise that the last stage used.
        fit: The optimum with its residuals and initial states.
        before: Fit of the initial states alone, with all parameters at their start values.
        logs: File names.
        seed: Seed of the method's draws.
        warnings: Assumptions and possible mistakes that the reader of the logs found.
    """

    system: ExtendedSystem
    estimates: dict[str, Estimate]
    zeros: tuple[Estimate, ...]
    of_logs: tuple[Estimate, ...]
    covariance: np.ndarray
    unidentified: tuple[Direction, ...]
    dispersion: Dispersion
    convergence: Convergence
    request: FitRequest
    fit: Fit
    before: Fit
    logs: tuple[str | None, ...]
    seed: int
    warnings: tuple[str, ...] = ()

    @property
    def correlation(self) -> np.ndarray:
        """(p, p) correlation matrix of the estimates."""
        sd = np.sqrt(np.diag(self.covariance)).clip(1e-300)
        return self.covariance / np.outer(sd, sd)

    @property
    def rms(self) -> dict[str, tuple[float, float, str]]:
        """Channel -> root mean square of the simulation error before the fit, after it, and the unit."""
        windows, result = self.request.windows, {}
        for c, channel in enumerate(self.system.measurements):
            valid = windows.valid[:, c]
            if valid.any():
                before, after = (
                    float(windows.errors(f.residual)[:, c][valid].square().mean().sqrt())
                    for f in (self.before, self.fit)
                )
                result[channel.name] = (before, after, channel.unit)
        return result

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings and lists; keys are only ever added."""
        return {
            "schema": 1,
            "system": self.system.name,
            "logs": list(self.logs),
            "warnings": list(self.warnings),
            "parameters": {e.name: _plain(e) for e in self.estimates.values()},
            "encoder_zeros": [_plain(e) for e in self.zeros],
            "of_logs": {e.name: _plain(e) for e in self.of_logs},
            "correlation": self.correlation.tolist(),
            "not_identified": [
                {"text": words, "weights": d.weights, "information": d.information}
                for words, d in zip(self.loose_in_words(), self.unidentified, strict=True)
            ],
            "simulation_rms": {
                name: {"before": before, "after": after, "unit": unit}
                for name, (before, after, unit) in self.rms.items()
            },
            "scale_gauges": [g.to_json() for g in self.gauges],
            "chi2_per_sample": self.dispersion.chi2_per_sample,
            "residual_correlation": self.dispersion.correlation,
            "windows": len(self.request.windows),
            "window_s": self.request.windows.length,
            "windows_resting": self.request.resting,
            "noise_sd": [n.sd for n in self.request.windows.noise],
            "convergence": {
                "method": self.convergence.method,
                "converged": self.convergence.converged,
                "reason": self.convergence.reason,
                "stages": [{"name": n, "cost": list(costs)} for n, costs in self.convergence.stages],
                "simulations": self.convergence.simulations,
                "seconds": self.convergence.seconds,
            },
            "seed": self.seed,
        }

    @property
    def gauges(self) -> tuple[Gauge, ...]:
        """Fitted parameters of which the data give only ratios."""
        return scale_gauges(self.fit, self.system.parameters)

    def loose_in_words(self) -> tuple[str, ...]:
        """Describe each combination that is not identified by one sentence."""
        return tuple(self._loose(direction) for direction in self.unidentified)

    def _loose(self, direction: Direction) -> str:
        sd = dict(zip(self.request.prior.names, np.sqrt(np.diag(self.request.prior.covariance)), strict=True))
        if len(direction.weights) == 1:
            name = next(iter(direction.weights))
            return f"the estimate of {name} comes from its prior, not from the data"
        shift = {name: weight * sd[name] for name, weight in direction.weights.items()}
        relative = {name: d / abs(self.estimates[name].value or np.inf) for name, d in shift.items()}
        largest = max((abs(r) for r in relative.values()), default=0.0)
        if largest == 0.0 or any(r == 0.0 for r in relative.values()):
            parts = [f"{name} by {d:+.3g} {self.estimates[name].unit}" for name, d in shift.items()]
        else:
            parts = [f"{name} by {r / largest:+.2f} %" for name, r in relative.items()]
        return f"the data cannot distinguish a change of {' and '.join(parts)} from no change"


def _plain(estimate: Estimate) -> dict[str, Any]:
    return {
        "value": estimate.value,
        "low": estimate.low,
        "high": estimate.high,
        "sd": estimate.sd,
        "unit": estimate.unit,
        "start": estimate.start,
        "bounds": [b if np.isfinite(b) else None for b in estimate.bounds],  # strict JSON has no infinity
        "at_bound": estimate.at_bound,
    }


def interval(value: float, sd: float, bounds: tuple[float, float]) -> tuple[float, float]:
    """95 % interval around a value, cut at the bounds; it always contains the value."""
    low, high = max(value - NORMAL_95 * sd, bounds[0]), min(value + NORMAL_95 * sd, bounds[1])
    return min(low, value), max(high, value)
