"""Result of a diagnosis and its contract, report.json."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from deepkoco.diagnose.gain import Gain, note_on_gain
from deepkoco.diagnose.residuals.residuals import MissingTorque
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit
from deepkoco.systems import ExtendedSystem, System

SCHEMA = 1
Verdict = Literal["cause", "nothing", "unknown", "ambiguous", "insufficient"]


@dataclass(frozen=True)
class Estimate:
    """One parameter with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Evidence:
    """One statistic for (or against) a cause, and its threshold."""

    kind: str
    statistic: float
    threshold: float
    text: str


@dataclass(frozen=True)
class Moved:
    """One parameter of the simulation whose value differs from the one given.

    Attributes:
        name: The parameter.
        given: Value before, of the simulation as given or as learned from healthy logs.
        estimate: Value after, with its 95 % interval.
        prior_sds: Distance in standard deviations of its prior.
        sum_with: Parameters that would do exactly the same: the data show only the sum of all of them.
        sum_given: That sum as given; 0 where there are none.
        instead: Other parameters of which one new value, each alone, would do exactly the same: the data show only the
            ratio or the product of them and this one.
    """

    name: str
    given: float
    estimate: Estimate
    prior_sds: float
    sum_with: tuple[str, ...] = ()
    sum_given: float = 0.0
    instead: tuple[Moved, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the parameter under the keys of report.json."""
        shared = {"sum_with": list(self.sum_with), "sum_given": self.sum_given} if self.sum_with else {}
        other = {"instead": [m.to_json() for m in self.instead]} if self.instead else {}
        own = {"name": self.name, "given": self.given, "prior_sds": self.prior_sds}
        return {**own, **vars(self.estimate), **shared, **other}


@dataclass(frozen=True)
class Finding:
    """One cause (or candidate) as the report shows it."""

    name: str
    family: str
    members: tuple[str, ...]
    delta_bic: float
    probability: float
    parameters: dict[str, Estimate]
    evidence: tuple[Evidence, ...] = ()
    given: dict[str, float] = field(default_factory=dict)  # value before, of a parameter that changed
    same_as: tuple[Moved, ...] = ()  # parameters of the simulation that would do exactly the same
    probabilities: dict[str, float] = field(default_factory=dict)  # of all that may stand in its place

    def to_json(self) -> dict[str, Any]:
        """Return the finding under the keys of report.json."""
        return {
            "name": self.name,
            "family": self.family,
            "class": list(self.members),
            "delta_bic": self.delta_bic,
            "probability": self.probability,
            **({"probabilities": self.probabilities} if self.probabilities else {}),
            "parameters": {n: vars(e) for n, e in self.parameters.items()},
            "evidence": [vars(e) for e in self.evidence],
            **({"given": self.given} if self.given else {}),
            **({"same_as": [m.to_json() for m in self.same_as]} if self.same_as else {}),
        }


@dataclass(frozen=True)
class Localisation:
    """A stretch of time in which more torque is missing than elsewhere."""

    t0: float
    t1: float
    channel: str
    size: float
    unit: str
    log: int = 0


@dataclass(frozen=True)
class Details:
    """Data of the figures; not part of report.json.

    Attributes:
        system: The system with every effect.
        channels: (name, unit) of each measurement.
        command_units: Unit of each command.
        priors: Baseline parameter -> (mean, standard deviation) of its prior.
        windows: Training windows.
        nominal: The system as given on these windows; None where there are held-out windows to show.
        refit: The refitted baseline.
        final: Fit with the named causes; the refit itself where none is named.
        missing: Missing load of the refitted baseline on each joint.
        inflation: Deflation of the final model's residuals, in noise variances.
    """

    system: ExtendedSystem
    channels: tuple[tuple[str, str], ...]
    command_units: tuple[str, ...]
    priors: dict[str, tuple[float, float]]
    windows: Windows
    nominal: Fit | None
    refit: Fit
    final: Fit
    missing: tuple[MissingTorque, ...]
    inflation: float


@dataclass(frozen=True)
class Diagnosis:
    """Verdict, named causes and gain of one diagnosis.

    Attributes:
        verdict: "cause", "ambiguous" (named, but causes of several families fit as well), "nothing",
            "unknown" (structure that nothing in the catalogue explains) or "insufficient" data.
        causes: Named causes, strongest first.
        candidates: Every candidate that was tried, ranked.
        gain: Held-out errors; None without held-out windows.
        chi2_before: chi2 per sample of the refitted baseline on the training windows.
        chi2_after: chi2 per sample with the named causes, or with the learned load instead of them.
        strength: Root mean square of what the causes (or the learned load) explain, in noise standard deviations.
        windows: Number of training windows.
        window_s: Their length [s].
        localisation: Stretches of time in which torque is missing.
        advice: Experiments that would answer open questions.
        data: Logs that were read, and windows that were left out.
        refit: Baseline parameters after the refit, with intervals.
        model: The extended system, with the fitted values as its nominal ones.
        seed: Seed.
        versions: Versions of the package and its dependencies.
        seconds: Wall-clock time of the diagnosis.
        detection: Fall of the BIC from which a cause is named.
        unexplained: Description of the remaining residuals, and combinations of parameters that are not identified.
        details: Arrays behind the figures; None when the data do not suffice.
        final: Baseline parameters of `model`, with intervals; a parameter kept as given has an interval of width 0.
        moved: Where nothing is missing: parameters far from their given values with which the simulation explains the
            log.
        evidence: Answer of the method of probabilities, which changes no verdict; None where it did not run.
        probabilities: Of "nothing", where nothing is missing, and of what might be missing all the same.
        time_limit: Time that was allowed [s]; None for no limit.
        left_out: Steps that were not made because this time was over.
        correlated: Values of the parameters of `model` under errors that are correlated in time; empty where these are
            no other estimates.
    """

    verdict: Verdict
    causes: tuple[Finding, ...]
    candidates: tuple[Finding, ...]
    gain: Gain | None
    chi2_before: float
    chi2_after: float
    strength: float
    windows: int
    window_s: float
    localisation: tuple[Localisation, ...]
    advice: tuple[str, ...]
    data: dict[str, Any]
    refit: dict[str, Estimate]
    model: System
    seed: int
    versions: dict[str, str]
    seconds: float
    detection: float
    unexplained: dict[str, Any] = field(default_factory=dict)
    details: Details | None = None
    final: dict[str, Estimate] = field(default_factory=dict)
    moved: tuple[Moved, ...] = ()
    evidence: dict[str, Any] | None = None
    probabilities: dict[str, float] = field(default_factory=dict)
    time_limit: float | None = None
    left_out: tuple[str, ...] = ()
    correlated: dict[str, float] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes, strongest first."""
        return tuple(c.name for c in self.causes)

    @property
    def prior_sds(self) -> dict[str, float]:
        """Parameter of the simulation -> distance of its final value, in standard deviations of its prior."""
        priors = {} if self.details is None else self.details.priors
        far = {n: e.value - priors[n][0] for n, e in self.final.items() if n in priors}
        return {n: change / priors[n][1] for n, change in far.items() if priors[n][1] > 0.0}

    @property
    def gain_note(self) -> str:
        """Sentences on the windows that measure the gain."""
        learned = (self.unexplained.get("residual_model") or {}).get("accepted", False)
        return note_on_gain(
            () if self.verdict == "unknown" else self.names,
            self.verdict == "unknown" and learned,
            self.gain is not None and self.gain.as_given,
            (self.unexplained.get("changed_midway") or {}).get("until_s"),
        )

    def save(self, folder: str | Path) -> Path:
        """Write report.html, report.json, the figures and model.yaml into a new folder.

        Args:
            folder: Folder that does not exist yet.

        Returns:
            Path of report.html.

        Raises:
            FolderExistsError: The folder exists.
        """
        return _report_writers[-1](self, folder)

    def to_json(self) -> dict[str, Any]:
        """Return the content of report.json: plain lists, numbers and text."""
        return _plain(
            {
                "schema": SCHEMA,
                "verdict": self.verdict,
                "causes": [c.to_json() for c in self.causes],
                "candidates": [c.to_json() for c in self.candidates],
                "gain": self._gain(),
                "fit": {
                    "chi2_per_sample_before": self.chi2_before,
                    "chi2_per_sample_after": self.chi2_after,
                    "strength": self.strength,
                    "windows": self.windows,
                    "window_s": self.window_s,
                    "refit": {n: vars(e) for n, e in self.refit.items()},
                    "final": {n: vars(e) for n, e in self.final.items()},
                    "correlated": self.correlated,
                    "prior_sds": self.prior_sds,
                    "moved": [m.to_json() for m in self.moved],
                },
                "localisation": [vars(place) for place in self.localisation],
                "excitation_advice": list(self.advice),
                "unexplained": self.unexplained,
                "data": self.data,
                "seed": self.seed,
                "versions": self.versions,
                "seconds": self.seconds,
                **({"probabilities": self.probabilities} if self.probabilities else {}),
                **({} if self.evidence is None else {"evidence": self.evidence}),
                **self._limited(),
            }
        )

    def _limited(self) -> dict[str, Any]:
        if self.time_limit is None:
            return {}
        return {"time_limit": {"seconds": self.time_limit, "left_out": list(self.left_out)}}

    def _gain(self) -> dict[str, Any] | None:
        if self.gain is None:
            return None
        g = self.gain
        return {
            "metric": "simulation_rmse",
            "horizon_s": g.horizon,
            "channels": {
                c.name: {"baseline": c.baseline, "refit": c.refit, "extended": c.extended, "unit": c.unit}
                for c in g.channels
            },
            "reduction_vs_refit": g.reduction,
            "low": g.low,
            "high": g.high,
            "windows": g.windows,
            "note": self.gain_note,
        }


_report_writers: list[Callable[[Diagnosis, Path | str], Path]] = []
Writer = TypeVar("Writer", bound=Callable[..., Path])


def saves_diagnoses(write: Writer) -> Writer:
    """Decorate the function that :meth:`Diagnosis.save` calls.

    The report is made of the diagnosis, so the diagnosis does not import the report.
    """
    _report_writers.append(write)
    return write


def _plain(value: Any) -> Any:
    """Replace numpy numbers by plain ones and non-finite values by None; round to seven digits."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        # Seven digits, because the last bits of a sum depend on the memory alignment of its operands.
        return float(f"{value:.7g}") if np.isfinite(value) else None
    return value
