"""Fit of a log at hand: the unit's parameters, the sizes of the causes and the noise for the design."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from deepkoco.diagnose.baseline import Baseline, baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.promising import WORTH
from deepkoco.diagnose.evidence.selection import rank
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.experiment_design.doses import Dose
from deepkoco.diagnose.experiment_design.experiment_setup import DesignError
from deepkoco.diagnose.experiment_design.separation import Separation, separate
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.data.windows import Windows, cut_windows, moving, window_length
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.held_values import with_held_values
from deepkoco.logs.recording import Recording
from deepkoco.systems import System

MIN_LOG_WINDOWS = 3


@dataclass(frozen=True)
class LogAtHand:
    """A fitted log.

    Attributes:
        start: The baseline.
        windows: Moving windows, with the states of the refit.
        refit: The refitted baseline.
        doses: Cause -> its fitted size; causes that the log does not show are left out.
    """

    start: Baseline
    windows: Windows
    refit: Fit
    doses: Mapping[str, Dose]

    @property
    def seconds(self) -> float:
        """Total length of the fitted windows [s]."""
        return len(self.windows) * self.windows.length

    def separation(self, doses: Sequence[Dose]) -> Separation:
        """Return the expected likelihood ratios between causes in this log."""
        return separate(self.start.system, self.windows, self.refit.values, self.start.prior, doses)


def fit_log(recordings: Sequence[Recording], system: System, causes: Sequence[Cause]) -> LogAtHand:
    """Refit the baseline on a log, and each cause on top of it.

    Raises:
        DesignError: The joint moves too little in the log, or the simulation diverges on it.
    """
    held = [with_held_values(log) for log in recordings]
    windows = cut_windows(held, system, window_length(system))
    if len(windows):
        windows = windows.take(moving(windows))
    if len(windows) < MIN_LOG_WINDOWS:
        raise DesignError(
            f"the joint moves in only {len(windows)} windows of {windows.length:.2g} s of the log, and "
            f"{MIN_LOG_WINDOWS} are needed; design from the system alone, without a log"
        )
    start = baseline_from(system, windows)
    try:
        windows, refit = refit_sharply(start, windows)
    except DivergedError as error:
        raise DesignError(f"the log cannot be fitted: {error}; check that it is of this system") from error
    problem = FitProblem(start.system, windows)
    chi2 = refit.chi2 / windows.samples
    hints = Hints(start.system, windows, missing_torque(problem, refit), chi2)
    ranking = rank(problem, start, refit, (), hints, list(causes))
    doses = {
        c.cause.name: Dose(c.cause, {n: c.fit.values[n] for n in c.cause.free})
        for c in ranking.candidates
        if c.likelihood_ratio > WORTH and c.fit is not refit
    }
    return LogAtHand(start, replace(windows, state=refit.state), refit, doses)
