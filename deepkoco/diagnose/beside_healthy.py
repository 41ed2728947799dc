"""Whether logs leave so much more than the healthy ones that no small effect of these could be named for them.

What a healthy log leaves beyond noise is what all of its small effects together explain of it. Each of them costs a
ranking of the whole catalogue, on logs that hardly show it. Where other logs leave fifty times as much, such an effect
is less than the share from which a cause is named beside a first one, so it need not be known.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline, Near, counting_floor
from deepkoco.diagnose.data import Data
from deepkoco.diagnose.evidence.minor import LEAST_SHARE
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.healthy import learn_as_simulated
from deepkoco.diagnose.refitted import Refitted, refit_to_logs, with_own_parameters
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.verdict.judgement import Judgement
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.fine_steps import with_steps_of
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.recording import Recording

LOWER = 0.5  # times what the healthy logs left beyond noise at the last refit, from which another one may tell more
Answered = tuple[DiagnosisRequest, Explanation, Judgement]
ITERATIONS = 12  # of a fit that only shows that a refit leaves no more


@dataclass
class BesideHealthy:
    """Logs to explain, beside the healthy ones of their unit.

    Attributes:
        request: The logs to explain.
        healthy: The healthy logs.
        told: What earlier fits of these have told; None for none.
        base: The last refit of the logs to explain; None where none was needed.
        far: Whether they are far beyond the healthy ones.
        begin: Values with which a refit has followed them; empty where none was made, or none has followed them.
        beyond: What the healthy logs left beyond noise when that refit was made.
    """

    request: DiagnosisRequest
    healthy: Sequence[Recording]
    told: Near | None = None
    base: Refitted | None = None
    far: bool = False
    begin: Mapping[str, float] = field(default_factory=dict)
    beyond: float = math.inf

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
        if _beyond_noise(learned) > LOWER * self.beyond:
            return False
        learned = self._begun(learned)
        if not _is_far(learned, _quickly_fitted(learned, self.request.data), self.request.data.train.samples):
            return False
        self.request.progress("refit of the simulation as the healthy logs tell it")
        try:
            base = refit_to_logs(learned, self.request.data)
        except DivergedError:
            return False
        self.base, self.far = base, _is_far(learned, base.reference, base.train.samples)
        if not self.far:
            self.begin = {n: base.reference.values[n] for n in learned.prior.names}
            self.beyond = _beyond_noise(learned)
        return self.far

    def _begun(self, learned: Baseline) -> Baseline:
        """Return a baseline whose refit to these logs begins where the last one has ended."""
        return (
            replace(learned, near=Near(self.begin, learned.wander, learned.step)) if self.begin else learned
        )

    def refit_of(self, learned: Baseline) -> Refitted | None:
        """Return their refit, now that the healthy logs are learned; None where it is not known.

        Args:
            learned: The baseline. Its effects may be more than those of the last refit.
        """
        base = self.base
        if base is None or base.learned.prior.names != learned.prior.names:
            return None
        if (base.learned.floor, base.learned.effects) != (learned.floor, learned.effects):
            return None
        return replace(base, learned=learned, start=replace(base.start, losing=learned.losing))

    def with_small_effects(self, found: Answered, explain: Callable[[Baseline], Answered]) -> Answered:
        """Explain the logs again, with all small effects of the healthy ones, where these may be a second cause or what
        is left.

        Args:
            found: What was asked in the end, the causes that were selected without these effects, and the verdict.
            explain: Baseline -> the same for the logs as they were asked about first.

        Returns:
            The same, or what is named with these effects.
        """
        _, explanation, judgement = found
        base, causes = explanation.base, explanation.found
        if not self.far or base.learned.healthy is None:
            return found
        left = judgement.verdict == "unknown" and not _is_far(base.learned, causes.final, base.train.samples)
        if not left and len(causes.accepted) < 2:
            return found
        if not self.request.limit.allows("small effects that the healthy logs show"):
            return found
        near = self.told and self.told._replace(values=base.learned.healthy.fit.values)
        with contextlib.suppress(DivergedError, np.linalg.LinAlgError):
            again = explain(self._learned(near))
            # An answer that ran out of time is no better than one that did not.
            if again[2].verdict != "unknown" and not self.request.limit.over:
                return again
        return found


def _is_far(learned: Baseline, fit: Fit, samples: int) -> bool:
    """Return whether a fit, with the floor counted as noise, leaves enough more than the healthy logs leave."""
    if fit.diverged or learned.healthy is None:
        return False
    # A refit that has left its prior far behind imitates something, and that is not small either.
    more = (max(fit.chi2 / samples - 1.0, 0.0) + fit.penalty / samples) * learned.floor
    return LEAST_SHARE * more > _beyond_noise(learned)


def _beyond_noise(learned: Baseline) -> float:
    """Return what the healthy logs leave beyond noise [noise variances a sample], or what just shows an effect."""
    assert learned.healthy is not None
    return max(learned.floor - 1.0, DETECTION / learned.healthy.windows.samples)


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
