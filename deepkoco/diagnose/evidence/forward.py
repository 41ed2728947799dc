"""Selection of causes: forward, with backward elimination; lost commands last, where causes leave much unexplained."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, catalogue, kind_of
from deepkoco.diagnose.causes.timing import LOST_COMMANDS
from deepkoco.diagnose.causes.units import LARGE_MISFIT
from deepkoco.diagnose.diagnosis import Finding
from deepkoco.diagnose.evidence.classes import equivalent
from deepkoco.diagnose.evidence.elimination import (
    BENDING,
    FLEXIBLE_CAUSES,
    PUSHES,
    carried,
    eliminated,
    without,
    without_kinds,
)
from deepkoco.diagnose.evidence.refine_ranking import front_settled, with_fit
from deepkoco.diagnose.evidence.residual_model import ResidualModel
from deepkoco.diagnose.evidence.sanity_checks import at_bound
from deepkoco.diagnose.evidence.seen_when_healthy import Hypothesis, consistent_with_healthy
from deepkoco.diagnose.evidence.selection import (
    FURTHER,
    PATIENCE,
    Ranking,
    penalty,
    prior_with,
    rank,
    strained,
    without_events_first,
)
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.lost_commands.report import best_losses, instead_of_push
from deepkoco.diagnose.progress import Progress, in_company_of, silent
from deepkoco.diagnose.residuals.residuals import (
    SLOTS,
    MissingTorque,
    coloured_from,
    dispersion,
    missing_torque,
    white_limit,
)
from deepkoco.diagnose.residuals.whiteness import more_than_noise
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem

MOST_CAUSES = 3
LOOKS = 3  # at each cause beside the others, at most
Step = tuple[Ranking, tuple[str, ...]]


@dataclass(frozen=True)
class Selected:
    """What a selection found.

    Attributes:
        final: Fit with everything found.
        accepted: Causes of the catalogue.
        steps: For each, the ranking that it won and the names that the data do not tell from it.
        acting: Training windows, with the commands that acted where some of those that were sent were lost.
        lost: Lost commands; None where none are named.
        charge: What the BIC charges for all of it.
    """

    final: Fit
    accepted: tuple[Cause, ...]
    steps: tuple[Step, ...]
    acting: FitProblem
    lost: Finding | None = None
    charge: float = 0.0


class Selection:
    """Selection of causes on top of a refitted baseline.

    Args:
        start: The baseline.
        train: Windows to explain.
        held: Windows that no fit sees; what does not carry over to them is dropped.
        causes: Causes to try; None tries the whole catalogue.
        detection: Fall of the BIC from which a first cause is named.
        progress: Told what begins.
    """

    def __init__(
        self,
        start: Baseline,
        train: Windows,
        held: Windows | None,
        causes: Sequence[Cause] | None,
        detection: float,
        progress: Progress = silent,
    ) -> None:
        self.progress = progress
        self.start, self.train, self.held = start, train, held
        self.causes, self.detection = causes, detection
        self.problem = FitProblem(start.system, train)
        self.before = math.inf  # chi2 of the refit

    def run(self, reference: Fit, missing: Sequence[MissingTorque]) -> tuple[Ranking, Selected]:
        """The first ranking (over the whole catalogue), and what is selected."""
        self.before = reference.chi2
        hints = self._hints(self.problem, reference, missing)
        self.progress("fitting every cause")
        first = rank(self.problem, self.start, reference, (), hints, self.causes)
        nothing = Selected(reference, (), (), self.problem)
        forward = self._forward(nothing, first, hints)
        first = forward.steps[0][0] if forward.steps else first
        plain = self._pruned(forward)
        found = self._with_losses(nothing, forward, plain)
        return first, self._or_losses(plain) if found is None else found

    def consistent_with_healthy(self, found: Selected) -> list[Cause]:
        """Causes that the unit may have had all the time: for each that was found, what the healthy logs allow of it
        and of those that the data do not tell from it."""
        hypotheses = []
        for ranking, members in found.steps:
            for candidate in ranking.candidates:
                cause, fit = candidate.cause, candidate.fit
                # Pushes, tones and detents of one log say nothing of another's.
                if cause.name not in members or not cause.free or kind_of(cause.name) in FLEXIBLE_CAUSES:
                    continue
                if fit is not ranking.reference:
                    freed = set(fit.free)
                    beside = [c for c in found.accepted if c.name != cause.name and freed.issuperset(c.free)]
                    hypotheses.append(Hypothesis(cause, tuple(beside), fit))
        verdicts = consistent_with_healthy(self.start, found.acting, hypotheses)
        return [hypothesis.cause for hypothesis, yes in zip(hypotheses, verdicts, strict=True) if yes]

    def _forward(
        self, so_far: Selected, ranking: Ranking | None = None, hints: Hints | None = None
    ) -> Selected:
        """Further causes, as long as they pay."""
        start, problem = self.start, so_far.acting
        final, accepted, steps, charge = so_far.final, [*so_far.accepted], [*so_far.steps], so_far.charge
        while len(accepted) < MOST_CAUSES:
            names = [*(c.name for c in accepted), *([so_far.lost.name] if so_far.lost else [])]
            if ranking is None or hints is None:
                self.progress(f"fitting every cause{in_company_of(names)}")
                hints = self._hints(problem, final, missing_torque(problem, final))
                ranking = rank(problem, start, final, accepted, hints, self.causes)
            wanted = FURTHER if accepted or so_far.lost else self.detection
            if not ranking.candidates or ranking.best.delta_bic <= wanted:
                break
            self.progress(f"what the data do not tell from {ranking.best.cause.name}{in_company_of(names)}")
            ranking = self._led(problem, ranking, accepted, hints)
            steps.append((ranking, equivalent(problem, start, ranking, tuple(accepted))))
            accepted.append(ranking.best.cause)
            final, ranking = ranking.best.fit, None
        return Selected(final, tuple(accepted), tuple(steps), problem, so_far.lost, charge)

    def _pruned(self, found: Selected) -> Selected:
        """Without causes that others make superfluous, or that do nothing for windows which no fit saw."""
        for _ in range(LOOKS):
            kept = self._kept(self._reconsidered(found))
            if kept.accepted == found.accepted:
                return kept
            found = kept
        return self._reconsidered(found)

    def _kept(self, found: Selected) -> Selected:
        # A single cause is left for the verdict to judge; not beside losses, which hide what it does for windows whose
        # own losses are not known.
        least = 1 if found.lost is None else 0
        if len(found.accepted) <= least:
            return found
        # What was worth its parameters when it was found need not be any more.
        kept, final = eliminated(found.acting, self.start, found.accepted, found.final, FURTHER, least)
        if self.held is not None and len(self.held) > 0:
            kept, final = carried(found.acting, self.start, kept, final, self.held, least)
        if dispersion(final, self.train).lag_one > coloured_from(self.train):
            kept, final = self._without(found.acting, kept, final, BENDING, 0.5)
        if more_than_noise(final, self.train, self.start) is not None:
            kept, final = self._without(found.acting, kept, final, PUSHES, 0.1)
        steps = tuple(s for s, c in zip(found.steps, found.accepted, strict=True) if c in kept)
        return replace(found, final=final, accepted=tuple(kept), steps=steps)

    def _without(
        self, problem: FitProblem, kept: Sequence[Cause], fit: Fit, kinds: Sequence[str], most: float
    ) -> tuple[Sequence[Cause], Fit]:
        """Without causes of these kinds, unless more than this share of what is explained is theirs: then the verdict
        judges."""
        rest, less = without_kinds(problem, self.start, kept, fit, kinds)
        gives_little = less.chi2 - fit.chi2 < most * (self.before - fit.chi2)
        return (rest, less) if gives_little else (kept, fit)

    def _reconsidered(self, found: Selected) -> Selected:
        """Each of several causes once more, beside all others.

        What was the best of all while the others were missing need not be the best beside them, and which causes the
        data do not tell apart depends on what the others leave.
        """
        if len(found.accepted) < 2:
            return found
        start, problem = self.start, found.acting
        accepted, steps, final = list(found.accepted), list(found.steps), found.final
        everything = catalogue(start.system.base).values() if self.causes is None else self.causes
        lasting = [c for c in everything if c.effect != "event"]
        for k, cause in enumerate(accepted):
            others = [*accepted[:k], *accepted[k + 1 :]]
            self.progress(f"{cause.name} once more{in_company_of(c.name for c in others)}")
            less = problem.fit_one(without(problem, start, accepted, cause, final), PATIENCE)
            hints = self._hints(problem, less, missing_torque(problem, less))
            # A push mends any window that another cause left; it is only put where it belongs beside the others.
            rivals = [cause] if cause.effect == "event" else lasting
            ranking = rank(problem, start, less, others, hints, rivals)
            ranking = front_settled(problem, start, others, with_fit(problem, ranking, cause, final))
            steps[k] = (ranking, equivalent(problem, start, ranking, tuple(others)))
            if ranking.best.cause.name != cause.name:
                accepted[k] = ranking.best.cause
            final = ranking.best.fit
        return replace(found, final=final, accepted=tuple(accepted), steps=tuple(steps))

    def _with_losses(self, nothing: Selected, forward: Selected, plain: Selected) -> Selected | None:
        """Lost commands and further causes, where they explain clearly more than causes alone.

        Losses are many places of known size, which bend to what any missing mechanism does; so they come last.

        Args:
            nothing: The refit.
            forward: Every cause in the order in which it was found.
            plain: Those that are left.
        """
        causes = self._losing()
        if not causes:
            return None
        best = self._lossy(plain, causes)
        left = plain.final.chi2 / self.train.samples > white_limit(self.train) * self.start.floor
        if best is None and not left and plain.accepted:
            return None
        prefixes = [nothing] if plain.accepted else []
        if len(forward.accepted) > 1:
            step = forward.steps[0]
            prefixes.append(
                replace(nothing, final=step[0].best.fit, accepted=forward.accepted[:1], steps=(step,))
            )
        rivals = [f for f in (best, *(self._lossy(p, causes) for p in prefixes)) if f is not None]
        if not rivals:
            return None
        # A cause beside losses has to pay as any further one.
        found = max(rivals, key=lambda f: self._score(f, nothing.final, rivals) - FURTHER * len(f.accepted))
        wanted = FURTHER if plain.accepted else self.detection
        everyone = [plain, *rivals]
        reference = nothing.final
        if self._score(found, reference, everyone) <= self._score(plain, reference, everyone) + wanted:
            return None
        return found

    def _or_losses(self, found: Selected) -> Selected:
        """With lost commands in the class of a push that they explain as well."""
        steps = list(found.steps)
        causes = self._losing()
        for k, cause in enumerate(found.accepted):
            if cause.effect == "event" and causes:
                self.progress(f"lost commands in the place of {cause.name}")
                ranking, members = steps[k]
                more = instead_of_push(found.acting, self.start, found.accepted, cause, found.final, causes)
                steps[k] = (ranking, (*members, *more))
        return replace(found, steps=tuple(steps))

    def _losing(self) -> list[Cause]:
        """Commands that are lost, but those of which healthy logs lose some, too."""
        known = catalogue(self.start.system.base).values() if self.causes is None else self.causes
        return [c for c in known if c.kind == LOST_COMMANDS.name and c.index not in self.start.losing]

    def _lossy(self, prefix: Selected, causes: Sequence[Cause]) -> Selected | None:
        """Lost commands on top of what is selected, and what else pays then."""
        self.progress(f"lost commands{in_company_of(c.name for c in prefix.accepted)}")
        start, fit = self.start, prefix.final
        prior = prior_with(self.problem, start, prefix.accepted, fit.values)
        wanted = FURTHER if prefix.accepted else self.detection
        found = best_losses(self.problem, fit, prior, causes, start.least_deflation, wanted)
        if found is None:
            return None
        lossy = replace(
            prefix, final=found.fit, acting=found.problem, lost=found.finding, charge=found.charge
        )
        return self._pruned(self._forward(lossy))

    def _score(self, found: Selected, reference: Fit, everyone: Sequence[Selected]) -> float:
        """Fall of the BIC from the refit, under what the best of all leaves."""
        lowest = min((f.final for f in everyone), key=lambda fit: fit.cost)
        return fall_of_bic(found, reference, lowest, self.start, self.train)

    def _led(self, problem: FitProblem, ranking: Ranking, accepted: Sequence[Cause], hints: Hints) -> Ranking:
        """A ranking with its winner fitted to the end."""
        start = self.start
        ranking = without_events_first(problem, start, ranking, accepted, hints, self.detection)
        ranking = front_settled(problem, start, accepted, ranking)
        best = ranking.best
        untried = hints.chi2 <= LARGE_MISFIT and not hints.strained
        if untried and at_bound(problem, best.cause, best.fit):
            # It wants more than it can give: perhaps a slip of units, which is not tried where so little is left.
            hints = Hints(hints.system, hints.windows, hints.missing, np.inf)
            again = rank(problem, start, ranking.reference, accepted, hints, self.causes)
            if not again.best.cause.free:
                return self._led(problem, again, accepted, hints)
        return ranking

    def _hints(self, problem: FitProblem, fit: Fit, missing: Sequence[MissingTorque]) -> Hints:
        far = strained(problem, self.start, fit)
        return Hints(self.start.system, problem.windows, missing, fit.chi2 / self.train.samples, far)


def fall_of_bic(found: Selected, reference: Fit, lowest: Fit, start: Baseline, train: Windows) -> float:
    """Fall of the BIC from a refit by everything that was selected.

    Args:
        found: The selection.
        reference: The refit.
        lowest: Fit whose residuals are taken for noise.
        start: The baseline.
        train: The windows.
    """
    spread = dispersion(lowest, train)
    samples, places = train.samples / spread.correlation, SLOTS * len(train)
    charge = found.charge + sum(penalty(cause, samples, places) for cause in found.accepted)
    return (reference.cost - found.final.cost) / max(spread.deflation, start.least_deflation) - charge


def learned_instead(
    found: Selected, reference: Fit, learned: ResidualModel, start: Baseline, train: Windows, least: float
) -> bool:
    """Whether a load that follows angle, speed and effort smoothly says as much as what was selected, or clearly more.

    A cause that is there leaves it nothing to say, and no smooth load looks like detents, tones and pushes; but these
    together bend to a smooth load.

    Args:
        found: The selection.
        reference: The refit.
        learned: The load that was learned on top of the refit.
        start: The baseline.
        train: The windows.
        least: Fall of the BIC by which it has to be ahead; below 0 it may be behind by so much.
    """
    if not learned.accepted:
        return False
    lowest = min(found.final, learned.fit, key=lambda fit: fit.cost)
    spread = dispersion(lowest, train)
    charge = len(learned.terms) * math.log(train.samples / spread.correlation)
    won = (reference.cost - learned.fit.cost) / max(spread.deflation, start.least_deflation) - charge
    return won > fall_of_bic(found, reference, lowest, start, train) + least
