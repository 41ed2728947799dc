"""Wrong units: which conversion constants are worth a fit in full."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.footholds import trial_of
from deepkoco.fit.fit import Fit, FitProblem, Trial

SLIPS = 4  # unit conversion constants that are fitted in full
SLIP_ITERATIONS = 6
FEW_WINDOWS = 4  # the same before any fit, with many parameters
SLIP_WINDOWS = 8  # windows that choose among the constants, before all windows are simulated
LARGE = 1000  # constants times windows from which this saves time: smaller batches take as long
FEW_ITERATIONS = 3  # on them: constants differ by factors
HOPELESS = (
    10.0  # cost of a unit slip over that of the reference, from which it is not fitted with many parameters
)


def states_read_by(shows: Sequence[int], logged: Sequence[bool], channel: int, joints: int) -> list[int]:
    """Return the states whose first values come from a channel, and are as wrong as its unit is.

    The speed of a joint that no channel of the log shows is read from its position: a position of the other direction
    has speeds of the other direction.

    Args:
        shows: State that each channel shows; positions come before speeds.
        logged: Whether the log has each channel.
        channel: Number of the channel.
        joints: Number of joints.
    """
    state = shows[channel]
    measured = {k for k, there in zip(shows, logged, strict=True) if there}
    return [state, state + joints] if state < joints and state + joints not in measured else [state]


def slipped(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    reference: Fit,
    slips: Sequence[tuple[Cause, Mapping[str, float]]],
    most: float,
) -> list[Trial]:
    """Return trials of unit conversion constants; they start from the baseline's values before the refit.

    Args:
        problem: Training windows.
        start: The baseline.
        accepted: Causes that are part of every fit.
        reference: Fit of the baseline with them.
        slips: The constants.
        most: Cost before a fit, over that of the reference, from which a constant is left out.
    """
    if not slips:
        return []
    before = {n: start.values[n] for n in start.prior.names}
    values = [{**reference.values, **before, **place} for _, place in slips]
    states = problem.windows.state.repeat(len(slips), 1, 1)
    for k, (cause, place) in enumerate(slips):
        if cause.kind == "channel_slip":
            # A model file declares speeds of all joints, and a log may have none of them.
            logged = problem.windows.valid.any(-1).any(0).tolist()
            read = states_read_by(problem.windows.shows, logged, cause.index, start.system.joints)
            states[k][:, read] /= next(iter(place.values()))
    if np.isfinite(most):
        theta = np.array([[float(v[n]) for n in problem.names] for v in values])
        # A wrong unit shows everywhere.
        few = torch.from_numpy(np.unique(np.linspace(0, len(problem.windows) - 1, FEW_WINDOWS).astype(int)))
        part = problem.of_windows(few)
        shown = part.predict(theta, states[:, few], reference.nuisance[None].repeat(len(values), 1))
        cost = part.weighed(part.windows.value - shown).square().sum((1, 2, 3)).nan_to_num(torch.inf)
        least = float(reference.residual[few].square().sum()) + reference.penalty
        # Initial states lower the cost of a simulation that is right a few times, and hardly that of others.
        hopeful = [k for k in cost.argsort().tolist() if cost[k] <= most * least][: 2 * SLIPS]
        slips, values, states = [slips[k] for k in hopeful], [values[k] for k in hopeful], states[hopeful]
        if not slips:
            return []
    if len(slips) > 2 * SLIPS and len(slips) * len(problem.windows) > LARGE:
        # A wrong unit shows everywhere, so a few windows tell which constants are worth the others.
        few = torch.from_numpy(np.linspace(0, len(problem.windows) - 1, SLIP_WINDOWS).astype(int))
        _, costs = problem.of_windows(few).fit_states_each(values, states[:, few], FEW_ITERATIONS)
        hopeful = costs.sum(-1).nan_to_num(torch.inf).argsort()[: 2 * SLIPS].tolist()
        slips, values, states = [slips[k] for k in hopeful], [values[k] for k in hopeful], states[hopeful]
    fitted, costs = problem.fit_states_each(values, states, SLIP_ITERATIONS)
    total = costs.sum(-1).nan_to_num(torch.inf)
    # Only the few constants with the lowest cost are fitted in full.
    return [
        trial_of(problem, start, accepted, slips[k][0], values[k], fitted[k], reference)
        for k in total.argsort()[:SLIPS].tolist()
        if bool(torch.isfinite(total[k]))
    ]
