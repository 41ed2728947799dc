"""Forward selection of causes with backward elimination; lost commands are tested last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.causes.units import LARGE_MISFIT
from deepkoco.diagnose.evidence.absorbed import absorbed, refit_without
from deepkoco.diagnose.evidence.around import lowest_around
from deepkoco.diagnose.evidence.elimination import (
    BENDING,
    PUSHES,
    carried,
    eliminated,
    without_kinds,
)
from deepkoco.diagnose.evidence.joint_by_joint import select_by_joint
from deepkoco.diagnose.evidence.minor import LEAST_SHARE, Minor, tolerated
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking
from deepkoco.diagnose.evidence.reconsider import alone, reconsidered
from deepkoco.diagnose.evidence.refine_ranking import classed, front_settled
from deepkoco.diagnose.evidence.sanity_checks import at_bound
from deepkoco.diagnose.evidence.seen_when_healthy import (
    consistent_with_healthy,
    healthy_shows_pushes,
    hypotheses_of,
)
from deepkoco.diagnose.evidence.selected import Selected, fall_of_bic, on_refit
from deepkoco.diagnose.evidence.selection import FURTHER, PATIENCE, rank, without_events_first
from deepkoco.diagnose.evidence.selection_task import FITTED_TO_ERROR, SelectionTask
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.lost_commands.report import best_losses, instead_of_push
from deepkoco.diagnose.progress import in_company_of
from deepkoco.diagnose.residuals.residuals import (
    MissingTorque,
    coloured_from,
    dispersion,
    missing_torque,
)
from deepkoco.diagnose.residuals.whiteness import more_than_noise
from deepkoco.fit.fit import Fit, FitProblem

MOST_CAUSES = 3
MAX_ROUNDS = 3  # of comparing each cause again and eliminating causes
MOST_TOLERATED = 2  # causes within their tolerance that a fit contains beside others


class First(NamedTuple):
    """The first ranking of a selection, and the data from which its causes chose their starts."""

    ranking: Ranking
    hints: Hints


class Selection(SelectionTask):
    """Selection of causes on top of a refitted baseline."""

    def run(self, reference: Fit, missing: Sequence[MissingTorque]) -> tuple[Ranking, Selected]:
        """Return the first ranking (over the whole catalogue) and the selection."""
        return self.go_on(self.first_ranking(reference, missing))

    def first_ranking(self, reference: Fit, missing: Sequence[MissingTorque]) -> First:
        """Return the ranking of the whole catalogue on top of a refit."""
        self.compare_with(reference)
        hints = self.hints(self.problem, reference, missing)
        self.progress("fitting every cause")
        first = rank(
            self.problem,
            self.start,
            reference,
            (),
            hints,
            self.causes,
            self.limit,
            wanted=self.detection,
            cross=True,
        )
        return First(first, hints)

    def go_on(self, asked: First) -> tuple[Ranking, Selected]:
        """Return the first ranking, its best candidates fitted to the end, and the selection."""
        first, hints = asked
        reference = first.reference
        self.compare_with(reference)
        nothing = Selected(reference, (), (), self.problem)
        forward = self._forward(nothing, first, hints)
        first = on_refit(forward.steps) or first
        plain = self._pruned(forward) if self.naming else forward
        lossy, elsewhere = self._with_losses(nothing, forward, plain)
        if elsewhere is not None:
            self.progress("every cause again, on a better refit that the search for lost commands has found")
            return self.go_on(self.first_ranking(elsewhere, missing_torque(self.problem, elsewhere)))
        if lossy is None:
            found = self._with_losses_in_class(plain) if self.naming else plain
        else:
            found = replace(lossy, plain=self.without_tolerated(replace(plain, minor=forward.minor)))
        return first, self.without_tolerated(replace(found, minor=forward.minor))

    def from_ranking(self, first: Ranking) -> Selected:
        """Select causes on top of the reference of a ranking of the whole catalogue, without lost commands."""
        reference = first.reference
        self.compare_with(reference)
        hints = self.hints(self.problem, reference, missing_torque(self.problem, reference))
        found = self._forward(Selected(reference, (), (), self.problem), first, hints)
        return self.without_tolerated(replace(self._pruned(found), minor=found.minor))

    def repeated(self, found: Selected, reference: Fit) -> Selected:
        """Compare the causes of a selection on other windows again, and eliminate causes.

        Args:
            found: The selection; its fit is one of this task's windows.
            reference: Refit of the baseline to these windows.
        """
        self.compare_with(reference)
        for _ in range(MAX_ROUNDS):
            kept = self._kept(reconsidered(self, found, 1, reference))
            if kept.accepted == found.accepted:
                break
            found = kept
        return self.without_tolerated(kept)

    def consistent_with_healthy(self, found: Selected) -> list[Cause]:
        """Return the accepted causes and members of their classes that may have been present in the healthy logs."""
        hypotheses = hypotheses_of(found)
        verdicts = consistent_with_healthy(self.start, found.acting, hypotheses)
        return [hypothesis.cause for hypothesis, yes in zip(hypotheses, verdicts, strict=True) if yes]

    def _forward(
        self, so_far: Selected, ranking: Ranking | None = None, hints: Hints | None = None
    ) -> Selected:
        """Accept further causes as long as the BIC falls enough."""
        start, problem = self.start, so_far.acting
        if start.tempering > 1.0:
            return select_by_joint(problem, start, so_far, self._ranked, ranking, self.detection)
        final, accepted, steps, charge = so_far.final, [*so_far.accepted], [*so_far.steps], so_far.charge
        healthy: list[Cause] = []  # accepted causes of which there is no more than a healthy machine has
        minor = so_far.minor
        while len(accepted) < MOST_CAUSES + len(healthy):
            names = [*(c.name for c in accepted), *([so_far.lost.name] if so_far.lost else [])]
            wanted = FURTHER if len(accepted) > len(healthy) or so_far.lost else self.detection
            if ranking is None or hints is None:
                if not self.limit.allows(f"a further cause{in_company_of(names)}"):
                    break
                self.progress(f"fitting every cause{in_company_of(names)}")
                hints = self.hints(problem, final, missing_torque(problem, final), not accepted)
                worth = 0.0 if len(accepted) == len(healthy) else LEAST_SHARE * (self.cost - final.cost)
                ranking = rank(problem, start, final, accepted, hints, self.causes, self.limit, worth, wanted)
            if not ranking.candidates or ranking.best.delta_bic <= wanted:
                break
            above = [c for c in ranking.candidates if c.delta_bic > wanted and c.fit is not ranking.reference]
            small = [self._minor(problem, ranking, c, healthy, accepted) for c in above]
            least = next((m for m in small if m is not None), None)
            if least is not None and all(small) and (least.share is not None or not self.left(final)):
                minor = (*minor, least)
                break
            if least is not None and least.share is None and least.cause is ranking.best.cause:
                # It is not named, but without it in the fit its part of the error would look like another cause.
                if len(healthy) == MOST_TOLERATED:
                    break
                steps.append((ranking, (least.cause.name,)))
                accepted.append(least.cause)
                healthy.append(least.cause)
                final, ranking = least.fit, None
                continue
            self.progress(f"class of {ranking.best.cause.name}{in_company_of(names)}")
            ranking = self._refined(problem, ranking, accepted, hints)
            members: tuple[str, ...] = (ranking.best.cause.name,)
            if self.naming:
                ranking, members = classed(problem, start, ranking, accepted, self.held)
                best = lowest_around(problem, start, accepted, ranking.best, ranking.deflation)
                ranking = replace(ranking, candidates=(best, *ranking.candidates[1:]))
            steps.append((ranking, members))
            accepted.append(ranking.best.cause)
            final, ranking = ranking.best.fit, None
        return Selected(final, tuple(accepted), tuple(steps), problem, so_far.lost, charge, minor)

    def _ranked(self, fit: Fit, accepted: Sequence[Cause]) -> Ranking:
        """Return the ranking of the catalogue on top of a fit with these causes."""
        self.progress(f"fitting every cause{in_company_of(c.name for c in accepted)}")
        hints = self.hints(self.problem, fit, missing_torque(self.problem, fit), not accepted)
        return rank(self.problem, self.start, fit, accepted, hints, self.causes, self.limit)

    def _minor(
        self,
        problem: FitProblem,
        ranking: Ranking,
        candidate: Candidate,
        healthy: Sequence[Cause],
        accepted: Sequence[Cause],
    ) -> Minor | None:
        """Return why a candidate would not be named although it is significant; None if it would be named."""
        cause, fit = candidate.cause, candidate.fit
        if self._usual_push(problem, ranking, cause) or tolerated(
            problem, self.start, cause, fit, ranking.deflation
        ):
            return Minor(cause, fit, None, ranking.deflation)
        share = candidate.likelihood_ratio / max(self.cost - fit.cost, 1e-300)
        if len(accepted) > len(healthy) and share < LEAST_SHARE:
            return Minor(cause, fit, share, ranking.deflation)
        return None

    def _usual_push(self, problem: FitProblem, ranking: Ranking, cause: Cause) -> bool:
        """Return whether a cause is a push of which the healthy logs show nearly as much."""
        if cause.effect != "event" or self.start.healthy is None:
            return False
        missing = missing_torque(problem, ranking.reference)
        usual = healthy_shows_pushes(self.start, problem.windows, missing, cause)
        (self.usual_pushes.add if usual else self.usual_pushes.discard)(cause.name)
        return usual

    def _pruned(self, found: Selected) -> Selected:
        """Compare each cause again and eliminate causes, until nothing changes or the rounds are used up."""
        first = on_refit(found.steps) if found.lost is None else None
        for _ in range(MAX_ROUNDS):
            kept = self._kept(reconsidered(self, found))
            if kept.accepted == found.accepted:
                return kept
            if len(kept.accepted) == 1:
                # Its ranking and class were those beside causes that are removed now.
                return reconsidered(self, kept, 1) if first is None else alone(self, kept, first)
            found = kept
        return reconsidered(self, found)

    def _kept(self, found: Selected) -> Selected:
        # A single cause stays, and the verdict tests it. Together with lost commands it can be removed here, because
        # the held-out windows, whose losses are not known, cannot test it.
        least = 1 if found.lost is None else 0
        if len(found.accepted) <= least:
            return found
        # Causes accepted later can make an earlier one superfluous.
        kept, final = eliminated(
            found.acting,
            self.start,
            found.accepted,
            found.final,
            self.needed(found),
            least,
            LEAST_SHARE,
            self.cost,
            self.tolerated(found),
            done := {},
        )
        if self.held is not None and len(self.held) > 0:
            kept, final = carried(found.acting, self.start, kept, final, self.held, least, done)
        if dispersion(final, self.train).lag_one > coloured_from(self.train):
            kept, final = self._without(found.acting, kept, final, BENDING, 0.5)
        if more_than_noise(final, self.train, self.start) is not None:
            kept, final = self._without(found.acting, kept, final, PUSHES, FITTED_TO_ERROR)
        steps = tuple(s for s, c in zip(found.steps, found.accepted, strict=True) if c in kept)
        return replace(found, final=final, accepted=tuple(kept), steps=steps)

    def _without(
        self, problem: FitProblem, kept: Sequence[Cause], fit: Fit, kinds: Sequence[str], most: float
    ) -> tuple[Sequence[Cause], Fit]:
        """Remove causes of these kinds, unless they explain more than this share of the total fall of chi2.

        If they do, they stay, and the verdict tests them.
        """
        rest, less = without_kinds(problem, self.start, kept, fit, kinds)
        if len(rest) == len(kept):
            return kept, fit
        gives_little = less.chi2 - fit.chi2 < most * (self._chi2_before(problem, rest, less) - fit.chi2)
        return (rest, less) if gives_little else (kept, fit)

    def _chi2_before(self, problem: FitProblem, causes: Sequence[Cause], fit: Fit) -> float:
        """Return what the refit leaves; where it takes up by its parameters what these causes explain, without that.

        What other parameters then make up for counts by how far that is from their priors.
        """
        if self.refit is None or not (names := absorbed(problem, self.start, self.refit, causes, fit)):
            return self.before
        without = refit_without(problem, self.start, self.refit, names, PATIENCE)
        return self.before if without.diverged else max(self.before, without.cost - self.refit.penalty)

    def _with_losses(
        self, nothing: Selected, forward: Selected, plain: Selected
    ) -> tuple[Selected | None, Fit | None]:
        """Accept lost commands and further causes if they explain clearly more than causes alone.

        A pattern of many losses can imitate almost any missing mechanism, so lost commands are tested last. If all they
        have done is to lead to a better refit, that is the second result.

        Args:
            nothing: The refit.
            forward: All causes of the forward selection, in their order.
            plain: The causes that remain after elimination.
        """
        causes = self.loss_causes()
        # While structure remains, no lost commands are named (see `verdict_of`), so they are not searched for where
        # a simulation of many parameters leaves much of it.
        if not causes or (self.start.tempering > 1.0 and self.left(plain.final)):
            return None, None
        best, elsewhere = self._with_searched_losses(plain, causes)
        left = self.left(plain.final)
        if elsewhere is not None or (best is None and not left and plain.accepted):
            return None, elsewhere
        prefixes = [nothing] if plain.accepted else []
        several = len(forward.accepted) > 1 and not forward.steps[0][0].beside
        if several and forward.accepted[:1] != plain.accepted:
            step = forward.steps[0]
            prefixes.append(
                replace(nothing, final=step[0].best.fit, accepted=forward.accepted[:1], steps=(step,))
            )
        rivals = [] if best is None else [best]
        for prefix in prefixes:
            found, elsewhere = self._with_searched_losses(prefix, causes)
            if elsewhere is not None:
                return None, elsewhere
            rivals += [] if found is None else [found]
        if not rivals:
            return None, None
        # A cause that is added to lost commands needs the same fall of the BIC as any further cause.
        found = max(rivals, key=lambda f: self._score(f, nothing.final, rivals) - FURTHER * len(f.accepted))
        wanted = FURTHER if plain.accepted else self.loss_detection
        everyone = [plain, *rivals]
        reference = nothing.final
        if self._score(found, reference, everyone) <= self._score(plain, reference, everyone) + wanted:
            return None, None
        return None if self.losses_fit_error(found, plain) else found, None

    def _with_losses_in_class(self, found: Selected) -> Selected:
        """Add lost commands to the class of a push if they explain the data as well."""
        steps = list(found.steps)
        causes = self.loss_causes()
        for k, cause in enumerate(found.accepted):
            if cause.effect == "event" and causes and self.limit.allows("lost commands"):
                self.progress(f"lost commands instead of {cause.name}")
                ranking, members = steps[k]
                more = instead_of_push(found.acting, self.start, found.accepted, cause, found.final, causes)
                steps[k] = (ranking, (*members, *more))
        return replace(found, steps=tuple(steps))

    def _with_searched_losses(
        self, prefix: Selected, causes: Sequence[Cause]
    ) -> tuple[Selected | None, Fit | None]:
        """Search lost commands on top of a selection, and then accept further causes.

        Returns:
            The selection with them, None where there are none; and a refit that explains what they had seemed to.
        """
        if not self.limit.allows("lost commands"):
            return None, None
        self.progress(f"lost commands{in_company_of(c.name for c in prefix.accepted)}")
        start, fit = self.start, prefix.final
        prior = prior_with(self.problem, start, prefix.accepted, fit.values)
        wanted = FURTHER if prefix.accepted else self.loss_detection
        losing = () if start.losing is None else start.losing
        found, without_them = best_losses(
            self.problem, fit, prior, causes, start.least_deflation, wanted, losing
        )
        if found is None:
            better = not prefix.accepted and without_them.cost < fit.cost
            return None, without_them if better else None
        lossy = replace(
            prefix, final=found.fit, acting=found.problem, lost=found.finding, charge=found.charge
        )
        return self._pruned(self._forward(lossy)), None

    def _score(self, found: Selected, reference: Fit, everyone: Sequence[Selected]) -> float:
        """Fall of the BIC from the refit, with the deflation of the best fit of all."""
        lowest = min((f.final for f in everyone), key=lambda fit: fit.cost)
        return fall_of_bic(found, reference, lowest, self.start, self.train)

    def _refined(
        self, problem: FitProblem, ranking: Ranking, accepted: Sequence[Cause], hints: Hints
    ) -> Ranking:
        """Return a ranking whose winner and close candidates are fitted to convergence."""
        start = self.start
        ranking = without_events_first(problem, start, ranking, accepted, hints, self.detection)
        ranking = front_settled(problem, start, accepted, ranking)
        best = ranking.best
        untried = hints.chi2 <= LARGE_MISFIT and not hints.strained
        if untried and at_bound(problem, best.cause, best.fit):
            # The estimate stops at its bound. The reason may be a wrong unit, which is not tried for so small a chi2.
            hints = Hints(hints.system, hints.windows, hints.missing, np.inf)
            again = rank(problem, start, ranking.reference, accepted, hints, self.causes, self.limit)
            if not again.best.cause.free:
                return self._refined(problem, again, accepted, hints)
        return ranking
