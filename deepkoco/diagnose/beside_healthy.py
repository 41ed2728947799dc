"""Whether logs leave so much more than the healthy ones that no small effect of these could be named for them.

What a healthy log leaves beyond noise bounds what all of its small effects together explain. Each of them costs a
ranking of the whole catalogue, on logs that hardly show it. Where other logs leave fifty times as much, such an effect
is less than the share from which a cause is named beside a first one, so it need not be known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from deepkoco.diagnose.baseline import Baseline, Near, counting_floor
from deepkoco.diagnose.data import Data
from deepkoco.diagnose.evidence.minor import LEAST_SHARE
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.healthy import learn_as_simulated
from deepkoco.diagnose.refitted import Refitted, refit_to_logs, with_own_parameters
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.verdict.judgement import Judgement, judge
from deepkoco.diagnose.weighed import explained
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.fine_steps import with_steps_of
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.recording import Recording

LOWER = 0.5  # times the floor of the last refit, below which another one may tell more
ITERATIONS = 12  # of a fit that only shows that a refit leaves no more


@dataclass
class BesideHealthy:
    """Logs to explain, beside the healthy ones of their unit.

    Attributes:
        request: The logs to explain.
        healthy: The healthy logs.
        told: What earlier fits of these have told; None for none.
        base: Refit of the logs to explain, where they are far beyond the healthy ones; None where they are not, or were
            not asked.
        near: Values with which a refit has followed them; empty where none was made, or none has followed them.
        floor: Floor of the healthy logs beside which it was made.
    """

    request: DiagnosisRequest
    healthy: Sequence[Recording]
    told: Near | None = None
    base: Refitted | None = None
    near: Mapping[str, float] = field(default_factory=dict)
    floor: float = math.inf

    def learned(self) -> Baseline:
        """Return the baseline of the healthy logs, with those of their small effects that could be named.

        Raises:
            DivergedError: The simulation of the healthy logs diverges.
        """
        return self._begun(self._learned(self.told, self.are_far_beyond))

    def _learned(self, near: Near | None, enough: Callable[[Baseline], bool] | None = None) -> Baseline:
        asked = self.request
        return learn_as_simulated(
            self.healthy,
            asked.system,
            asked.length,
            asked.progress,
            limit=asked.limit,
            near=near,
            enough=enough,
        )

    def are_far_beyond(self, learned: Baseline) -> bool:
        """Return whether no small effect of the healthy logs could be named for these logs.

        Args:
            learned: Baseline learned from the healthy logs, with what they leave so far.
        """
        if learned.floor > LOWER * self.floor:
            return False
        learned = self._begun(learned)
        if not _is_far(learned, _quickly_fitted(learned, self.request.data), self.request.data.train.samples):
            return False
        try:
            base = refit_to_logs(learned, self.request.data)
        except DivergedError:
            return False
        if not _is_far(learned, base.reference, base.train.samples):
            self.near = {n: base.reference.values[n] for n in learned.prior.names}
            self.floor = learned.floor
            return False
        self.base = base
        return True

    def _begun(self, learned: Baseline) -> Baseline:
        """Return a baseline whose refit to these logs begins where the last one has ended."""
        return replace(learned, near=Near(self.near, learned.wander, learned.step)) if self.near else learned

    def refit_of(self, learned: Baseline) -> Refitted | None:
        """Return their refit, now that the healthy logs are learned; None where it is not known.

        Args:
            learned: The baseline that was asked about last, with what else is known of its logs.
        """
        base = self.base
        return base and replace(base, learned=learned, start=replace(base.start, losing=learned.losing))

    def with_small_effects(
        self, explanation: Explanation, judgement: Judgement, unfitted: Sequence[str]
    ) -> tuple[Explanation, Judgement]:
        """Explain the logs again, with all small effects of the healthy ones, where these may be a second cause or what
        is left.

        Args:
            explanation: Causes that were selected without these effects.
            judgement: The verdict on them.
            unfitted: What could not be fitted so far, in words.

        Returns:
            The same, or what is named with these effects.
        """
        base, known, found = explanation.base, explanation.base.learned.healthy, explanation.found
        if self.base is None or known is None:
            return explanation, judgement
        left = judgement.verdict == "unknown" and not _is_far(base.learned, found.final, base.train.samples)
        if not left and len(found.accepted) < 2:
            return explanation, judgement
        if not self.request.limit.allows("small effects that the healthy logs show"):
            return explanation, judgement
        delays = {n: known.fit.values[n] for c in known.causes for n in c.free}
        near = Near(known.fit.values, known.windows.wander, known.before.step, delays)
        try:
            again = explained(self.request, self._learned(near), unfitted)
            judged = judge(self.request, again)
        except DivergedError:
            return explanation, judgement
        return (explanation, judgement) if judged.verdict == "unknown" else (again, judged)


def _is_far(learned: Baseline, fit: Fit, samples: int) -> bool:
    """Return whether a fit, with the floor counted as noise, leaves enough more than the healthy logs leave."""
    if fit.diverged or learned.healthy is None:
        return False
    # A refit that has left its prior far behind imitates something, and that is not small either.
    more = (max(fit.chi2 / samples - 1.0, 0.0) + fit.penalty / samples) * learned.floor
    # An effect that a log at the floor just shows is one that it leaves.
    usual = max(learned.floor - 1.0, DETECTION / learned.healthy.windows.samples)
    return LEAST_SHARE * more > usual


def _quickly_fitted(learned: Baseline, data: Data) -> Fit:
    """Return a fit of the unit's own parameters from those of the healthy logs."""
    if learned.healthy is not None:
        # The recorder is theirs.
        data = replace(data, train=replace(data.train, noise=learned.healthy.windows.noise))
    start, data = with_own_parameters(learned, data)
    start, windows = counting_floor(start, with_steps_of(data.train, start.step))
    problem, values = FitProblem(start.system, windows), start.begun().values
    state, _ = problem.fit_states(values, windows.state)
    return problem.fit([Trial("refit", start.prior.names, start.prior, values, state)], ITERATIONS)[0]
