"""Whether a log shows that its commands have noise which no motor felt, and which share of their roughness it is.

A current that a driver measured holds such noise, and so do the rows of a controller that is faster than its log. A
command that a loop wrote down acted as it is, with all the noise that its feedback put into it. The first samples after
any instant tell which: whatever parameters or causes are wrong, a joint moves within so short a time as its state and a
smooth load make it, and answers each jump of a command that acted. Source: likelihood of a variance component, in
directions in which it is diagonal; Searle, Casella and McCulloch, Variance Components (1992).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import root_scalar
from scipy.stats import chi2
from torch import Tensor

from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Fit
from deepkoco.fit.solve.noise_moves import EARLY, inside, moves_of
from deepkoco.fit.solve.thin_svd import thin_svd
from deepkoco.fit.tangent import Tangent, simulated

SHORT = (24, 48, 96, 192)  # samples in a row that tell whether commands have noise; the fewest that show it
PER_POWER = 48  # of these, for each power of time of an unknown load within them
PLENTY = 200.0  # information by which they show noise plainly, likewise
SHOWS = 30.0  # information by which they show noise, as the mean fall of minus twice the log likelihood
PLACES = 3  # of each window, from which so many samples are taken
MOST_PLACES = 60  # in all
# One of so many of them is asked first, which can tell plainly that there is no noise. A window has one to three.
FIRST = 5
FEW = 0.3  # share of the places that may be such as nothing of the commands explains
SAME = 1e-9  # relative size of a direction that others span
# Of the variance that no smooth command has, as noise; a command that acted as it is has none.
SHARES = (0.5, 0.7, 1.0)
EVIDENCE = 10.0  # fall of minus twice the log likelihood from which a command is believed to have noise
WIDE = 3.0  # variance by noise, of those of the sensors, from which a direction shows its size by itself
DIRECTIONS = 4  # of a place that are so wide, from which they show whether noise has made all of them alike
# Times the largest noise of the logged commands, as a variance, that those have which no row shows.
SMALLEST, LARGER = 0.2, 4.0
CLEAR = 4.0  # squared slope in its standard deviations from which the log is believed to hold the noise
FELT = 4.0  # rise of it from which the motor has felt the roughness of its command
WIDER = 1.5  # step between the numbers of slow waves of a command, of which one is kept out of its roughness


class Answer(NamedTuple):
    """What some samples in a row say of noise of the commands.

    Attributes:
        power: (K,) squared residuals along moves by noise, in noise variances of the sensors.
        width: (K,) variances of them by the largest noise.
        along: Residuals along what the roughness of the logged commands would have done; its mean is minus the share
            of noise in it, times ``whole``.
        whole: Mean of what all of the roughness as noise makes of that, with the sign turned.
        spread: Variance of it.
    """

    power: np.ndarray
    width: np.ndarray
    along: float
    whole: float
    spread: float


class Shown(NamedTuple):
    """Noise of the commands that a log shows.

    Attributes:
        share: Its variance, as a share of the largest noise of the commands.
        logged: Its covariance with the logged commands, likewise.
    """

    share: float
    logged: float

    @classmethod
    def nothing(cls) -> Shown:
        """No noise."""
        return cls(0.0, 0.0)


def shown_noise(
    problem_of: Callable[[Windows], FitProblem], windows: Windows, fit: Fit, most: Sequence[float]
) -> Shown:
    """Return the most likely noise of the commands; none where none is believed.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows.
        fit: A fit of them.
        most: Standard deviation of the largest noise of each command.
    """
    problem, size = problem_of(windows), fit.state.shape[1]
    # Encoders show the motion itself, whatever filters a speed has passed.
    shown = [c for c, s in enumerate(windows.shows) if s < size // 2 and bool(windows.valid[:, c].any())]
    # A stretch of samples in a row is one of time, too.
    shown = [c for c in shown if torch.equal(windows.t[:, c], windows.t[:, shown[0]])]
    if not shown:
        return Shown.nothing()
    theta = np.array([float(fit.values[n]) for n in problem.names])
    tangent = Tangent.at(problem, theta, np.zeros(0, dtype=int), fit.state)
    states = tangent.slopes(simulated(problem, [tangent], fit.nuisance[None]), problem)  # (S, W, N, M)
    asked = [s for s in SHORT if s <= int(windows.valid[:, shown].sum(-1).max())]
    answers = partial(_short_answers, problem_of, windows, fit, most, shown, states)
    if not asked:
        return Shown.nothing()
    places = _places(windows, shown, asked[-1])
    found = answers(asked[-1], places, list(range(0, len(places), FIRST)))
    few = _share_of_directions(found) if _tells(found, PLENTY) else None
    if few is not None and few < SMALLEST:
        return Shown.nothing()
    # The longest stretches show the most: where they show nothing, shorter ones need not be asked.
    found += answers(asked[-1], places, [k for k in range(len(places)) if k % FIRST])
    if not _tells(found):
        return Shown.nothing()
    seen = [found]
    share = _share_of_directions(found)
    if share is not None and share <= LARGER:
        return _shown(seen, share) if share >= SMALLEST else Shown.nothing()
    for short in asked[:-1]:
        places = _places(windows, shown, short)
        seen.append(answers(short, places, range(len(places))))
        if _tells(seen[-1], PLENTY):
            found = seen[-1]
            break
    found = [own for own in found if own.width.any()]
    if max(_gain(found, share) for share in SHARES) < EVIDENCE:
        return Shown.nothing()
    # Of noise of a share s, the mean power is 1 + s width. A model error is now larger and now smaller than that.
    told = [float(((own.power - 1.0) * own.width).sum() / (own.width**2).sum()) for own in found]
    share = min(float(np.median(told)), 1.0)
    return _shown(seen, share) if share >= SHARES[0] and not _felt(seen, share) else Shown.nothing()


def _shown(seen: list[list[Answer]], share: float) -> Shown:
    """Return noise of this share, and which share of the roughness of the logged commands it is."""
    slope, information = _slope(seen)
    told = -slope if slope < 0.0 and slope**2 * information > CLEAR else 0.0
    return Shown(share, min(told, 1.0, math.sqrt(share)))


def _share_of_directions(answers: list[Answer]) -> float | None:
    """Return the share of noise by which most directions are as wide as they are; None where too few are wide.

    Noise makes each of them as wide as its own moves. A wrong model, which leaves more, leaves it in a few: those of
    slow moves.
    """
    power, width = (np.concatenate([getattr(own, what) for own in answers]) for what in ("power", "width"))
    wide = width >= WIDE
    if wide.sum() < DIRECTIONS * len(answers):
        return None
    power, width = power[wide], width[wide]
    typical = float(chi2.median(1))
    if np.median(power) <= typical:
        return 0.0
    largest = float((power / width).max()) / typical

    def beyond(share: float) -> float:
        return float(np.median(power / (1.0 + share * width))) - typical

    return float(root_scalar(beyond, bracket=(0.0, largest)).root)


def _tells(answers: list[Answer], least: float = SHOWS) -> bool:
    return sum(float((own.width - np.log1p(own.width)).sum()) for own in answers) >= least


def _gain(answers: list[Answer], share: float) -> float:
    """Return the fall of minus twice the log likelihood by noise, without the places that say most for it.

    What happens in a few places, such as a push, is no noise of the commands.
    """
    each = [
        float((own.power * share * own.width / (1.0 + share * own.width) - np.log1p(share * own.width)).sum())
        for own in answers
    ]
    return sum(sorted(each)[: math.ceil((1.0 - FEW) * len(each))])


def _felt(seen: list[list[Answer]], share: float) -> bool:
    """Return whether the motion has answered the roughness of its commands, rather than a share of it being noise.

    A wrong model leaves large residuals, too, but none that go with the roughness, whose every jump the log holds.

    Args:
        seen: Answers of stretches of different lengths; the one that knows most counts.
        share: Share of the variance.
    """
    slope, information = _slope(seen)
    return ((slope + share) ** 2 - slope**2) * information > FELT


def _slope(seen: list[list[Answer]]) -> tuple[float, float]:
    """Return by which share of the roughness of the commands more of it was felt, and the information of that."""
    known = [
        np.array([(own.along, own.whole, own.spread) for own in each if own.spread > 0.0]).reshape(-1, 3).T
        for each in seen
    ]
    along, whole, spread = max(known, key=lambda each: float((each[1] ** 2 / each[2]).sum()))
    information = float((whole**2 / spread).sum())
    return float((along * whole / spread).sum()) / max(information, EARLY), information


def _places(windows: Windows, shown: list[int], short: int) -> list[tuple[int, int]]:
    """Return windows and first samples of stretches of so many samples in a row, evenly chosen."""
    counts = windows.valid[:, shown].sum(-1).amin(1).numpy()
    places = [
        (w, int(at))
        for w, n in enumerate(counts)
        if n >= short
        for at in np.unique(np.linspace(0, n - short, min(PLACES, n // short)).astype(int))
    ]
    some = np.unique(np.linspace(0, len(places) - 1, min(MOST_PLACES, len(places))).astype(int))
    return [places[k] for k in some]


def _short_answers(
    problem_of: Callable[[Windows], FitProblem],
    windows: Windows,
    fit: Fit,
    most: Sequence[float],
    shown: list[int],
    states: Tensor,
    short: int,
    places: Sequence[tuple[int, int]],
    picked: Sequence[int],
) -> list[Answer]:
    """Return what some samples in a row say at each place, without what their state and a smooth load explain.

    Args:
        problem_of, windows, fit, most: As for :func:`shown_noise`.
        shown: Channels that count.
        states: (S, W, N, M) weighted moves by the initial states.
        short: How many samples.
        places: Windows, and the first of these samples in each.
        picked: Numbers of the places that are asked. All of them tell how long so many samples last.
    """
    clock = shown[0]
    if not picked:
        return []
    rows, begin = np.array(places).T
    t, weight = windows.t[:, clock].numpy(), problem_of(windows).weight
    length = float(np.median(t[rows, begin + short - 1] - t[rows, begin]))
    places = [places[k] for k in picked]
    rows, begin = np.array(places).T
    first, last = inside(windows, rows, windows.t0[rows] + t[rows, begin], length)
    moves = moves_of(problem_of, windows, fit, most, rows, first, int((last - first).max()))
    smooth = np.linspace(-1.0, 1.0, moves.shape[-1])[:, None] ** np.arange(max(short // PER_POWER, 1) + 1)
    result = []
    for k, (w, at) in enumerate(places):
        part = slice(at, at + short)
        moved = (
            (moves[k] * weight[w][..., None, None])[shown][:, part]
            .numpy()
            .reshape(len(shown) * short, len(most), -1)
        )
        own = fit.residual[w][shown][:, part].numpy().ravel()
        of_state = states[:, w][:, shown][:, :, part].flatten(1).numpy().T
        basis = _basis_of(
            np.concatenate([of_state, *(moved[:, c] @ smooth for c in range(len(most)))], axis=1)
        )
        left, moved = own - basis @ (basis.T @ own), moved.reshape(len(own), -1)
        vectors, singular, right = thin_svd(moved - basis @ (basis.T @ moved))
        shown_by = right.reshape(len(right), len(most), -1)
        amount = _amounts(windows, w, int(first[k]), int((last - first).max()), most, shown_by.shape[-1])
        result.append(_answer(vectors.T @ left, singular, shown_by, amount))
    return result


def _amounts(
    windows: Windows, w: int, first: int, count: int, sd: Sequence[float], pieces: int
) -> np.ndarray:
    """Return the logged commands (C, P) of the pieces of a place, in the pieces' standard deviations."""
    command, each = windows.commands[windows.log[w]], math.ceil(count / pieces)
    found = np.zeros((len(sd), min(len(command.t) - first, count) // each))
    for index, size in enumerate(sd):
        if size > 0.0:
            part = command.column(index)[first : first + each * found.shape[1]].reshape(-1, each)
            found[index] = part.mean(1) * math.sqrt(each) / size
    return found


def _answer(left: np.ndarray, singular: np.ndarray, shown_by: np.ndarray, amount: np.ndarray) -> Answer:
    """Return what residuals along moves by noise say.

    Args:
        left: (K,) residuals.
        singular: (K,) sizes of the moves.
        shown_by: (K, C, P) pieces of noise that make them.
        amount: (C, P') logged commands of the first of these pieces, in standard deviations of the noise.
    """
    power, width = left**2, singular**2
    weight = 1.0 / (1.0 + width)
    pieces = amount.shape[1]
    # Where a model error is larger than noise, the place says less.
    errors = max(float((power * weight).mean()), 1.0)
    best = Answer(power, width, 0.0, 0.0, 0.0)
    slow, information = 1, 0.0
    while slow < pieces - 2:
        # A straight line and slow waves are the command itself.
        rest = np.eye(pieces) - (basis := _slow_waves(pieces, slow)) @ basis.T
        rough = shown_by[..., :pieces] @ rest
        moved = singular * np.einsum("kcp,cp->k", rough, amount)
        whole = float((weight * width) @ (rough**2).sum((1, 2)))
        spread = max(float((weight * moved) @ moved), whole) * errors
        if whole**2 > information * spread:
            information = whole**2 / spread
            best = best._replace(along=float((weight * moved) @ left), whole=whole, spread=spread)
        slow = math.ceil(WIDER * slow)
    return best


@cache
def _slow_waves(pieces: int, waves: int) -> np.ndarray:
    """Return an orthonormal basis (P, waves + 2) of straight lines and the slowest cosine waves."""
    place = (np.arange(pieces) + 0.5) / pieces
    waves_of = np.cos(np.pi * place[:, None] * np.arange(1, waves + 1))
    return np.linalg.qr(np.concatenate([np.ones((pieces, 1)), place[:, None], waves_of], 1))[0]


def _basis_of(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of what columns (n, c) span."""
    size = np.linalg.norm(columns, axis=0)
    vectors, singular, _ = thin_svd(columns[:, size > 0.0] / size[size > 0.0])
    return vectors[:, singular > SAME * singular.max(initial=SAME)]
