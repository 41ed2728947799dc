"""The baseline refitted to the logs: every later stage of a diagnosis compares with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from deepkoco.diagnose.baseline import Baseline, prior_of_mean
from deepkoco.diagnose.baseline_refit import refit_counting_floor
from deepkoco.diagnose.data import Data
from deepkoco.diagnose.evidence.absorbed import refit_without
from deepkoco.diagnose.evidence.event_windows import train_on_pushed
from deepkoco.diagnose.evidence.kinks import without_kinks
from deepkoco.diagnose.tempered import refit_to_windows
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.command_noise import with_noise_like
from deepkoco.fit.solve.fine_steps import with_steps_cut
from deepkoco.fit.solve.guessed_commands import guesses_in, with_lost_rows_fitted
from deepkoco.fit.solve.prior import Prior

PATIENCE = 40  # iterations of a refit in which some parameters are kept
ROUGHLY = 12  # the same where they are far off, so that it can only be bad


@dataclass(frozen=True)
class Refitted:
    """A baseline and its refit to the training windows.

    Attributes:
        learned: The baseline before the refit; its prior is that of one log.
        start: The baseline of this fit; with run-to-run variance, its prior is that of the mean of the logs.
        data: The windows with the noise that the refit leaves.
        problem: The fit of the training windows.
        reference: The refit.
    """

    learned: Baseline
    start: Baseline
    data: Data
    problem: FitProblem
    reference: Fit

    @property
    def train(self) -> Windows:
        """The training windows."""
        return self.data.train

    @property
    def held(self) -> Windows | None:
        """The held-out windows; None where there are none."""
        return self.data.held if self.data.held is not None and len(self.data.held) > 0 else None


def with_parameters_kept(base: Refitted, names: Sequence[str]) -> Refitted:
    """Return the baseline with a refit in which some parameters keep the values given.

    The refit itself may move a changed parameter as far as the cause that names it. It could then not show what this
    cause explains.

    Args:
        base: The refitted baseline.
        names: The parameters; with none, or where this simulation diverges, ``base`` is returned.
    """
    if not names:
        return base
    most = PATIENCE if base.start.tempering == 1.0 else ROUGHLY
    fit = refit_without(base.problem, base.start, base.reference, names, most)
    return base if fit.diverged else replace(base, reference=base.problem.recentred(fit))


def data_with_lost_rows_fitted(
    problem_of: Callable[[Windows], FitProblem], data: Data, fit: Fit, prior: Prior
) -> tuple[Data, Fit]:
    """Fit the commands in the place of lost rows of training windows, and those of held-out windows.

    What acted in a lost row is no more known of held-out windows than their initial states are.

    Args:
        problem_of: Gives the problem of such windows.
        data: The windows.
        fit: A fit of the training windows.
        prior: Prior of its free parameters.

    Returns:
        The windows, and the fit of the training windows; those in which more than noise is left are as they were.
    """
    train, fit = with_lost_rows_fitted(problem_of, data.train, fit, prior)
    held = data.held
    if held is not None and len(held) > 0 and guesses_in(held):
        states = problem_of(held).evaluate(fit.values)
        if not states.diverged:
            held, _ = with_lost_rows_fitted(problem_of, held, states, prior)
    return replace(data, train=train, held=held), fit


def with_own_parameters(learned: Baseline, data: Data) -> tuple[Baseline, Data]:
    """Return the baseline and the data of logs that each have parameters of their own, as each healthy log had.

    Args:
        learned: The baseline; its prior is that of one log.
        data: The windows of the logs to explain; with a single log, or without run-to-run variance, they stay.
    """
    if learned.runs is None or (data.own and len(data.train.commands) == 1):
        return learned, data
    start, varies = prior_of_mean(learned)
    return start, data.varying(varies)


def refit_to_logs(learned: Baseline, data: Data) -> Refitted:
    """Refit a baseline to the training windows.

    Args:
        learned: The baseline, as given or as learned from healthy logs.
        data: The windows of the logs to explain.
    """
    start, data = with_own_parameters(learned, data)
    # The floor of a healthy unit counts as noise; otherwise the refit would leave its prior to fit it.
    refit = refit_counting_floor if start.least_deflation > 1.0 else refit_to_windows
    start, train, reference = refit(start, data.train)
    varies = train.varies if data.held is not None and data.held.varies else {}
    held = None if data.held is None else replace(data.held, noise=train.noise, varies=varies)
    if held is not None:
        held = with_steps_cut(held, round(data.train.step / train.step))
    if held is not None and train.wander is not None:
        # Its noise already contains what is not told from that of the sensors.
        noise = held.noise
        held = with_noise_like(partial(FitProblem, start.system), held, reference.values, train.wander)
        held = replace(held, noise=noise)
    if held is not None and train.doubt is not None:
        # Whether something else happens in a held-out window is not known, but how well its channels are simulated is.
        held = replace(held, doubt=train.doubt.amin(0).expand(len(held), -1).clone())
    if held is not None and any(train.stamp_sd):
        # Other logs of the same recorder are taken to have its typical clock.
        usual = float(np.sqrt(np.mean(np.square(train.stamp_sd))))
        clocks = train.stamp_sd if data.own else (usual,) * len(held.commands)
        held = replace(held, stamp_sd=clocks)
    data = replace(data, train=train, held=held)
    data, reference = data_with_lost_rows_fitted(
        partial(FitProblem, start.system), data, reference, start.prior
    )
    train, held = data.train, data.held
    if held is not None and data.own:
        train, held, reference = train_on_pushed(start, train, held, reference)
    problem = FitProblem(start.system, train)
    reference = without_kinks(problem, start, reference)
    return Refitted(learned, start, replace(data, train=train, held=held), problem, reference)
