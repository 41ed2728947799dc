"""What a selection of causes is asked, and what each of its steps uses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, catalogue
from deepkoco.diagnose.causes.timing import LOST_COMMANDS
from deepkoco.diagnose.evidence.minor import Minor, tolerated
from deepkoco.diagnose.evidence.priors import prior_with, strained
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.evidence.selection import FURTHER, PATIENCE
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.progress import Progress, silent
from deepkoco.diagnose.residuals.residuals import MissingTorque, dispersion
from deepkoco.diagnose.residuals.whiteness import more_than_noise
from deepkoco.diagnose.time_limit import TimeLimit
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial

# Share of what is explained. Pushes and lost commands can fit a part of any model error. Where they explain less, and
# more than noise is left, they are no causes, and no reason to doubt those beside them.
FITTED_TO_ERROR = 0.1


class SelectionTask:
    """A refitted baseline, its windows, and the causes to select among.

    Args:
        start: The baseline.
        train: Training windows.
        held: Held-out windows; a cause that raises their error is removed.
        causes: Causes to try; None tries the whole catalogue.
        detection: Fall of the BIC from which a first cause is accepted.
        progress: Called with the name of each step.
        limit: Asked before every step but the first ranking; None allows all.
        loss_detection: Fall of the BIC from which lost commands alone are accepted; None for that of a cause.
    """

    def __init__(
        self,
        start: Baseline,
        train: Windows,
        held: Windows | None,
        causes: Sequence[Cause] | None,
        detection: float,
        progress: Progress = silent,
        limit: TimeLimit | None = None,
        loss_detection: float | None = None,
    ) -> None:
        self.progress, self.limit = progress, TimeLimit() if limit is None else limit
        self.start, self.train, self.held = start, train, held
        self.causes, self.detection = causes, detection
        self.loss_detection = detection if loss_detection is None else loss_detection
        self.problem = FitProblem(start.system, train)
        self.before = self.cost = math.inf  # chi2 of the refit; its cost, with the penalty of the prior
        self.refit: Fit | None = None
        # Whether causes are told from what is alike and compared again; else the fit alone is wanted, and no name.
        self.naming = True
        self.usual_pushes: set[str] = set()  # pushes that are no stronger than those of healthy logs

    def compare_with(self, refit: Fit) -> None:
        """Measure what causes explain from this refit on."""
        self.refit, self.before, self.cost = refit, refit.chi2, refit.cost

    def left(self, fit: Fit) -> bool:
        """Return whether a fit leaves more than noise."""
        return fit.chi2 / self.train.samples > self.start.most_noise(self.train)

    def tolerated(self, found: Selected) -> list[Cause]:
        """Return the selected causes of which there is no more than any healthy machine has."""
        deflation = self.deflation(found.final)
        return [
            c
            for c in found.accepted
            if c.name in self.usual_pushes or tolerated(found.acting, self.start, c, found.final, deflation)
        ]

    def needed(self, found: Selected) -> float:
        """Return the fall of the BIC that a cause needs: what is tolerated is no company of a single one."""
        single = len(found.accepted) - len(self.tolerated(found)) < 2 and found.lost is None
        return self.detection if single else FURTHER

    def deflation(self, fit: Fit) -> float:
        """Return how much less correlated residuals tell than independent ones; at least as with healthy logs."""
        return max(dispersion(fit, self.train).deflation, self.start.least_deflation)

    def without_tolerated(self, found: Selected) -> Selected:
        """Take the causes within their tolerance out of the selection; the fit still contains them."""
        small = self.tolerated(found)
        if not small:
            return found
        deflation = self.deflation(found.final)
        kept = [(c, s) for c, s in zip(found.accepted, found.steps, strict=True) if c not in small]
        return replace(
            found,
            accepted=tuple(c for c, _ in kept),
            steps=tuple(s for _, s in kept),
            minor=(*found.minor, *(Minor(c, found.final, None, deflation) for c in small)),
        )

    def hints(
        self, problem: FitProblem, fit: Fit, missing: Sequence[MissingTorque], alone: bool = True
    ) -> Hints:
        """Return the data from which causes choose their start values beside a fit.

        Args:
            problem: The windows.
            fit: The fit.
            missing: Its missing loads.
            alone: Whether the fit is without causes.
        """
        far = strained(problem, self.start, fit, alone)
        return Hints(self.start.system, problem.windows, missing, fit.chi2 / self.train.samples, far)

    def loss_causes(self) -> list[Cause]:
        """Return lost commands of every command channel, except those of which healthy logs are known to lose some."""
        known = catalogue(self.start.system.base).values() if self.causes is None else self.causes
        losing = () if self.start.losing is None else self.start.losing.found
        return [c for c in known if c.kind == LOST_COMMANDS.name and c.index not in losing]

    def losses_fit_error(self, found: Selected, plain: Selected) -> bool:
        """Return whether lost commands explain little and leave more than noise.

        Real losses leave only noise, so these would not be named. They would take along the names of causes that
        explain nearly everything.

        Args:
            found: Lost commands with causes.
            plain: The causes that were selected without lost commands.
        """
        if more_than_noise(found.final, self.train, self.start) is None:
            return False
        if found.accepted == plain.accepted:
            alone = plain.final
        else:
            prior = prior_with(self.problem, self.start, found.accepted, found.final.values)
            f = found.final
            alone = self.problem.fit_one(
                Trial(f.name, prior.names, prior, f.values, f.state, f.nuisance), PATIENCE
            )
        return alone.chi2 - found.final.chi2 < FITTED_TO_ERROR * (self.before - found.final.chi2)
