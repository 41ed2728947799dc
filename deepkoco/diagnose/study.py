"""One diagnosis under way: refit, selection, verdict, and the result that is built from them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import (
    Baseline,
    prior_of_mean,
    refit_sharply,
    with_floor_as_noise,
)
from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.data import MIN_TRAINING_WINDOWS, Data, describe_data
from deepkoco.diagnose.diagnosis import Details, Diagnosis, Estimate, Finding
from deepkoco.diagnose.evidence.event_windows import refit_elsewhere, train_on_pushed
from deepkoco.diagnose.evidence.forward import Selection
from deepkoco.diagnose.evidence.ranking import Ranking
from deepkoco.diagnose.evidence.residual_model import ResidualModel, learn_residual
from deepkoco.diagnose.evidence.sanity_checks import (
    doubts_of_bending,
    doubts_of_commands,
    doubts_of_estimates,
    doubts_of_friction,
    doubts_of_names,
)
from deepkoco.diagnose.evidence.selected import Selected, Step, learned_instead
from deepkoco.diagnose.evidence.selection import DETECTION, FURTHER, PATIENCE
from deepkoco.diagnose.gain import Gain, held_out_gain, kept_as_given
from deepkoco.diagnose.healthy import describe_healthy, extended
from deepkoco.diagnose.lost_commands.search import why_not_searched
from deepkoco.diagnose.progress import Progress
from deepkoco.diagnose.residuals.residuals import (
    SLOTS,
    MissingTorque,
    coloured_from,
    dispersion,
    missing_torque,
    white_limit,
)
from deepkoco.diagnose.residuals.signatures import signatures
from deepkoco.diagnose.residuals.spectrum import spectrum_of
from deepkoco.diagnose.verdict.advice import always_there, class_advice, level_advice, not_fitted
from deepkoco.diagnose.verdict.findings import estimates, evidence_for, finding, localise, motion_of
from deepkoco.diagnose.verdict.moved import moved_parameters
from deepkoco.diagnose.verdict.noise_causes import scatter_findings
from deepkoco.diagnose.verdict.same_as import evidence_of_priors, same_parameter
from deepkoco.diagnose.verdict.shortage import missing_for_diagnosis
from deepkoco.diagnose.verdict.unknown import describe
from deepkoco.diagnose.verdict.verdict import only_flexible, rivalled, verdict_of
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.identifiability import Direction, unidentified
from deepkoco.fit.solve.scaled_inverse import DivergedError, scaled_inverse
from deepkoco.logs.recording import Recording
from deepkoco.output.versions import versions
from deepkoco.systems import ExtendedSystem, System

MOST_EXTENSIONS = 3  # times that causes consistent with the healthy logs join the baseline


class Study:
    """State of one diagnosis."""

    def __init__(
        self,
        system: System,
        start: Baseline,
        data: Data,
        detection: float,
        causes: Sequence[Cause] | None,
        progress: Progress,
        unfitted: Sequence[str] = (),
    ) -> None:
        self.progress, self.unfitted = progress, tuple(unfitted)
        self.causes = causes
        self.system, self.detection = system, detection
        self.data, self.given = data, data
        self.start = start
        self.lost: Finding | None = None
        self.accepted: tuple[Cause, ...] = ()
        self.steps: tuple[Step, ...] = ()
        self.doubts: tuple[str, ...] = ()
        self.joined: tuple[str, ...] = ()

    def _take(self, start: Baseline) -> None:
        """Refit a baseline to the training windows."""
        self.progress("refit of the simulation as given")
        self.learned = start
        data = self.given
        if start.runs is not None and not (data.own and len(data.train.commands) == 1):
            # With run-to-run variance, each log to explain has its own parameters, as each healthy log had.
            start, varies = prior_of_mean(start)
            data = data.varying(varies)
        train, self.reference = refit_sharply(start, data.train)
        if start.least_deflation > 1.0:
            # The floor of the healthy unit counts as noise; otherwise the refit would leave its prior to fit it.
            start, train, self.reference = with_floor_as_noise(start, train)
        varies = train.varies if data.held is not None and data.held.varies else {}
        held = None if data.held is None else replace(data.held, noise=train.noise, varies=varies)
        if held is not None and data.own:
            train, held, self.reference = train_on_pushed(start, train, held, self.reference)
        self.start, self.data = start, replace(data, train=train, held=held)
        self.problem = self.acting = FitProblem(start.system, train)

    def _selected(self) -> tuple[Ranking, Selected]:
        """Return the first ranking and the selection, on a baseline with all causes consistent with healthy logs."""
        more = MOST_EXTENSIONS
        while True:
            missing = missing_torque(self.problem, self.reference)
            selection = Selection(
                self.start, self.data.train, self.data.held, self.causes, self.detection, self.progress
            )
            first, found = selection.run(self.reference, missing)
            causes = selection.consistent_with_healthy(found) if more else []
            if not causes:
                return first, found
            more -= 1
            self.progress(f"healthy logs again, with {', '.join(c.name for c in causes)}")
            self.joined = (*self.joined, *(c.name for c in causes if c.name not in self.joined))
            self._take(extended(self.start, causes))

    def run(self, recordings: Sequence[Recording], length: float, seed: int, began: float) -> Diagnosis:
        self._take(self.start)
        first, found = self._selected()
        self.unfitted = (*self.unfitted, *first.unfitted)
        problem, start, data = self.problem, self.start, self.data
        # Reports and models give the mean parameters of these logs, not of all logs of the unit.
        plain, self.reference = found.final is self.reference, problem.recentred(self.reference)
        reference = self.reference
        found = replace(found, final=reference if plain else found.acting.recentred(found.final))
        final, self.accepted, self.steps = found.final, found.accepted, found.steps
        self.acting, self.lost = found.acting, found.lost
        scattered = scatter_findings(self.start.system, data.train, final, self.detection)
        after = dispersion(final, data.train)
        before = self._unchanged(reference)
        missing = missing_torque(problem, before, after.deflation)
        limit = white_limit(data.train) * start.floor
        gain = self._gain(before, final, seed)
        alike = coloured_from(data.train)
        white = after.lag_one <= alike
        self.doubts = (
            *doubts_of_commands(data.train, self.system),
            *doubts_of_estimates(problem, self.accepted, final),
            *doubts_of_friction(start.system, self.accepted, final, missing, after.deflation),
            *doubts_of_bending(start, self.accepted, self.lost, data.train, final),
        )
        verdict = verdict_of(found, start, data.train, before, gain, white, self.doubts)
        learned = None
        rival = verdict in ("cause", "ambiguous") and rivalled(found, start, data.train)
        if verdict == "unknown" or rival:
            self.progress("a learned load")
            learned = self._learned_load(missing, seed)
        if rival and learned is not None:
            least = -FURTHER if only_flexible(found) else FURTHER
            smooth = learned_instead(found, reference, learned, start, data.train, least)
            verdict, learned = ("unknown", learned) if smooth else (verdict, None)
            self.doubts += doubts_of_names(self.accepted, self.lost) if smooth else ()
        named = self._named(missing, final) if verdict in ("cause", "ambiguous") else ()
        if scattered and (verdict != "unknown" or (white and not self.accepted and self.lost is None)):
            # White residuals that are larger than the noise need a noise cause; no other cause is missing.
            verdict, named = (verdict if self.accepted else "cause"), (*named, *scattered)
        if verdict not in ("cause", "ambiguous") and final is not reference:
            # The causes are not named, so the rest of the report must not use their fit.
            final, gain, after, before = reference, None, dispersion(reference, data.train), reference
            missing = missing_torque(problem, reference, after.deflation)
        kept = learned if learned is not None and learned.accepted else None
        at_end = final if kept is None else kept.fit
        if kept is not None:
            gain = kept.gain
        gain = self._gain(before, final, seed) if gain is None else gain
        if kept is None and final is reference and gain is not None:
            gain = kept_as_given(gain, start.system, seed) or gain
        remaining = missing if final is reference else missing_torque(self.acting, final)
        left = describe(remaining, after)
        if verdict == "unknown":
            named = (Finding("unknown", "unknown", ("unknown",), 0.0, 0.0, {}),)
        candidates = tuple(finding(problem, c, first, before=start.values) for c in first.candidates)
        traced = (*scattered, *([self.lost] if self.lost else []))
        candidates = tuple(sorted((*candidates, *traced), key=lambda c: -c.delta_bic))
        loose = self._unidentified()
        return Diagnosis(
            verdict=verdict,
            causes=named,
            candidates=candidates,
            gain=gain,
            chi2_before=before.chi2 / data.train.samples,
            chi2_after=at_end.chi2 / data.train.samples,
            strength=float(np.sqrt(max(before.chi2 - at_end.chi2, 0.0) / data.train.samples)),
            windows=len(data.train),
            window_s=length,
            localisation=localise(missing),
            advice=self._advice(named, recordings, seed),
            data={**describe_data(recordings, data), "healthy": describe_healthy(self.learned)},
            refit=estimates(problem, reference, reference.free, first.deflation),
            model=self._model(final, kept, gain),
            seed=seed,
            versions=versions(),
            seconds=time.perf_counter() - began,
            unexplained={
                **left,
                "not_identified": [vars(d) for d in loose],
                "limits": {"chi2_per_sample": limit, "lag_one": alike},
                "white": final.chi2 / data.train.samples <= limit and after.lag_one <= alike,
                "spectrum": spectrum_of(remaining),
                "doubts": list(self.doubts),
                "allowed_by_healthy_logs": list(self.joined),
                "not_fitted": list(self.unfitted),
                "lost_commands_not_searched": why_not_searched(data.train, start.losing),
                "signatures": [vars(e) for e in signatures(self.system, data.train, final)],
                **({} if learned is None else {"residual_model": learned.to_json()}),
            },
            detection=self.detection,
            details=self._details(reference, final, missing),
            final=self._written(final, kept, gain, after.deflation),
            moved=moved_parameters(problem, start, reference) if verdict == "nothing" else (),
        )

    def _unchanged(self, reference: Fit) -> Fit:
        """Return the refit in which the parameters that the causes change keep their values.

        The refit itself may have moved them as far as the causes do. It could then not show what they explain.
        """
        kept = [n for c in self.accepted if is_changed(c) for n in c.free]
        if not kept:
            return reference
        values = {**reference.values, **{n: self.start.values[n] for n in kept}}
        state, _ = self.problem.fit_states(values, reference.state)
        free = tuple(n for n in reference.free if n not in kept)
        trial = Trial("refit", free, self.start.prior, values, state, reference.nuisance)
        fit = self.problem.fit([trial], PATIENCE)[0]
        return reference if fit.diverged else self.problem.recentred(fit)

    def _written(
        self, final: Fit, learned: ResidualModel | None, gain: Gain | None, deflation: float
    ) -> dict[str, Estimate]:
        """Return the system's own parameters as `_model` writes them; parameters kept as given have no interval."""
        fit = final if learned is None else self.problem.recentred(learned.fit)
        own = estimates(self.problem, fit, self.reference.free, deflation)
        if gain is None or not gain.as_given:
            return own
        given = {name: self.start.values[name] for name in own}
        return {name: Estimate(given[name], given[name], given[name], e.unit) for name, e in own.items()}

    def _unidentified(self) -> tuple[Direction, ...]:
        reference, prior = self.reference, self.start.prior
        if self.data.train.varies:
            # The mean of these logs has the prior of one log; the information of the data is the rest.
            prior = self.learned.prior
            order = [reference.free.index(n) for n in prior.names]
            known = scaled_inverse(reference.covariance[np.ix_(order, order)]) - prior.precision(prior.names)
            back = np.argsort(order)
            reference = replace(reference, information=known[np.ix_(back, back)])
        return unidentified(reference, prior)

    def _details(self, reference: Fit, final: Fit, missing: Sequence[MissingTorque]) -> Details:
        prior = self.learned.prior
        held = self.data.held is not None and len(self.data.held) > 0
        spread = np.sqrt(np.diag(prior.covariance))
        return Details(
            system=self.start.system,
            channels=tuple((c.name, c.unit) for c in self.system.measurements),
            command_units=tuple(c.unit for c in self.system.commands),
            priors={
                n: (float(m), float(s)) for n, m, s in zip(prior.names, prior.centre, spread, strict=True)
            },
            windows=self.data.train,
            nominal=None if held else self._as_given(reference),
            refit=reference,
            final=final,
            missing=tuple(missing),
            inflation=dispersion(final, self.data.train).deflation,
        )

    def _as_given(self, reference: Fit) -> Fit | None:
        """Return the simulation before the refit; None where it diverges."""
        try:
            return self.problem.evaluate(self.start.values, "baseline", reference.state)
        except DivergedError:
            return None

    def _advice(
        self, named: Sequence[Finding], recordings: Sequence[Recording], seed: int
    ) -> tuple[str, ...]:
        logs = [str(r.path) for r in recordings if r.path is not None]
        train, classes = self.data.train, ()
        if any(len(found.members) > 1 for found in named):
            start = replace(self.start, prior=self.learned.prior)
            classes = class_advice(self.system, start, train, self.steps, logs, seed)
        return (
            *not_fitted(self.unfitted),
            *always_there(self.joined),
            *classes,
            *level_advice(train, self.system),
        )

    def _learned_load(self, missing: Sequence[MissingTorque], seed: int) -> ResidualModel | None:
        data = self.data
        try:
            return learn_residual(self.start, data.train, data.held, self.reference, missing, seed)
        except DivergedError as error:
            self.unfitted = (*self.unfitted, f"a learned load ({error})")
            return None

    def _named(self, missing: Sequence[MissingTorque], final: Fit) -> tuple[Finding, ...]:
        places = SLOTS * len(self.data.train)
        prior, healthy = self.learned.prior, self.learned.healthy is not None
        spread = np.sqrt(prior.covariance.diagonal())
        priors = {n: (float(m), float(s)) for n, m, s in zip(prior.names, prior.centre, spread, strict=True)}
        result = []
        for ranking, members in self.steps:
            # The reported values are fitted together with the causes accepted later.
            best = replace(ranking.best, fit=final)
            own = missing[best.cause.joint or 0]
            motion = motion_of(self.data.train, own, self.system)
            evidence = evidence_for(best.cause, best, ranking, motion, own, places)
            if not is_changed(best.cause):
                evidence += evidence_of_priors(ranking.reference, ranking.best.fit, priors, healthy)
            named = finding(self.problem, best, ranking, members, evidence, self.start.values)
            same = same_parameter(self.acting, best.cause, final, self.start.values, ranking.deflation)
            result.append(replace(named, same_as=same))
        return (*result, *([self.lost] if self.lost else []))

    def _gain(self, reference: Fit, final: Fit, seed: int) -> Gain | None:
        if self.data.held is None or len(self.data.held) == 0:
            return None
        quiet, refit = {"event.torque": 0.0}, reference
        if final is not reference and any(c.effect == "event" for c in self.accepted):
            refit = refit_elsewhere(self.start, self.data.train, reference, final)
        models = {
            "baseline": self.start.values,
            "refit": {**refit.values, **quiet},
            "extended": {**final.values, **quiet},
        }
        held, problem = self.data.held, self.problem
        windows = {
            "baseline": replace(held, varies={}),
            "refit": problem.elsewhere(held, refit),
            "extended": problem.elsewhere(held, final),
        }
        gain = held_out_gain(self.start.system, windows, models, seed)
        said = "the held-out windows, so there is no gain"
        if gain is None and said not in self.unfitted:
            self.unfitted = (*self.unfitted, said)
        return gain

    def _model(self, final: Fit, learned: ResidualModel | None, gain: Gain | None) -> ExtendedSystem:
        had = tuple(e.name for e in self.system.effects) if isinstance(self.system, ExtendedSystem) else ()
        named = () if final is self.reference else self.accepted
        found = tuple(c.effect for c in named if c.effect != "event" and not is_changed(c))
        if learned is not None:
            final, found = self.problem.recentred(learned.fit), (*found, *learned.effects)
        effects = tuple(dict.fromkeys((*had, *self.start.effects, *found)))
        values = self.start.values if gain is not None and gain.as_given else final.values
        kept = {
            p.name: values[p.name]
            for p in self.start.system.parameters
            if "." not in p.name or p.name.split(".")[0] in effects
        }
        base = self.system.base if isinstance(self.system, ExtendedSystem) else self.system
        return ExtendedSystem(base, effects, kept)


def insufficient(
    data: Data, system: System, recordings: Sequence[Recording], length: float, seed: int, began: float
) -> Diagnosis:
    found = len(data.train)
    advice = missing_for_diagnosis(recordings, system, data.train.noise, length, found, MIN_TRAINING_WINDOWS)
    return Diagnosis(
        "insufficient",
        (),
        (),
        None,
        float("nan"),
        float("nan"),
        0.0,
        found,
        length,
        (),
        advice,
        describe_data(recordings, data),
        {},
        system,
        seed,
        versions(),
        time.perf_counter() - began,
        DETECTION,
    )
