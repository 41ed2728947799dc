"""Whether the commands of a log are measured ones with noise, and what this noise does to a simulation of it.

A current that a driver measured holds noise that no motor felt; a command that a loop wrote down acted as it is, with
all the noise that its feedback put into it. The first samples after any instant tell which: whatever parameters or
causes are wrong, a joint moves within so short a time as its state and a smooth load make it, and answers each jump of
a command that acted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import root_scalar
from scipy.stats import chi2
from torch import Tensor

from deepkoco.fit.data.noise import estimate_noise
from deepkoco.fit.data.series import CommandSeries
from deepkoco.fit.data.wander import Wander, compressed
from deepkoco.fit.data.windows import HISTORY, WARM_UP, Windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Fit, Trial
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.tangent import Tangent, simulated

PIECES = 96  # of noise of a command in one window at most; each is the mean of some neighbouring commands
SHORT = (24, 48, 96, 192)  # samples in a row that tell whether commands have noise; the fewest that show it
PER_POWER = 48  # of these, for each power of time of an unknown load within them
PLENTY = 200.0  # information by which they show noise plainly, likewise
SHOWS = 30.0  # information by which they show noise, as the mean fall of minus twice the log likelihood
PLACES = 3  # of each window, from which so many samples are taken
MOST_PLACES = 60  # in all
LARGEST = 1 << 27  # moves by pieces of noise that are kept at once
FEWEST = 16  # pieces of a command in one window, however many windows there are
FEW = 0.3  # share of the places that may be such as nothing of the commands explains
SAME = 1e-9  # relative size of a direction that others span
EARLY = 1e-9  # by which a command may be before a span [s]
# Of the variance that no smooth command has, as noise; a command that acted as it is has none.
SHARES = (0.5, 0.7, 1.0)
EVIDENCE = 10.0  # fall of minus twice the log likelihood from which a command is believed to have noise
WIDE = 3.0  # variance by noise, of those of the sensors, from which a direction shows its size by itself
DIRECTIONS = 4  # of a place that are so wide, from which they show whether noise has made all of them alike
# Times the largest noise of the logged commands, as a variance, that those have which no row shows.
SMALLEST, LARGER = 0.2, 4.0
FELT = 4.0  # rise of it from which the motor has felt the roughness of its command
WIDER = 1.5  # step between the numbers of slow waves of a command, of which one is kept out of its roughness
LEFT = 0.25  # noise variances of a typical sample that count as noise of the sensors
MOST = 96  # pieces of noise that are told from it
LANES = 2000  # windows in one batch of simulations


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


def with_command_noise(
    problem_of: Callable[[Windows], FitProblem], windows: Windows, values: Mapping[str, float], state: Tensor
) -> Windows:
    """Return windows with what noise of the commands does to their measurements, where these have noise.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows, with the noise of the sensors.
        values: Parameters near those of the unit.
        state: (W, S) initial states to begin with.

    Returns:
        The windows; the same ones where the motion answers the commands as logged, or does not tell.
    """
    most = noise_of_commands(windows)
    if len(windows) == 0 or not any(most):
        return windows
    fit = _simulation(problem_of(windows), values, state)
    if fit.diverged:
        return windows
    share = _share_of_noise(problem_of, windows, fit, most)
    if share == 0.0:
        return windows
    return with_noise(problem_of, windows, fit, tuple(math.sqrt(share) * sd for sd in most))


def with_noise(
    problem_of: Callable[[Windows], FitProblem], windows: Windows, fit: Fit, sd: tuple[float, ...]
) -> Windows:
    """Return windows with what noise of the commands does to their measurements.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows, with the noise of the sensors.
        fit: A simulation of them.
        sd: Standard deviation of the noise of each command, in its unit.
    """
    moves = moves_by_noise(problem_of, windows, fit, sd)
    weight = windows.valid.to(torch.float64) / windows.sample_sd
    few, rest = compressed(moves, weight, LEFT, MOST)
    noise = tuple(
        n.with_simulated(variance) for n, variance in zip(windows.noise, rest.tolist(), strict=True)
    )
    return replace(windows, noise=noise, wander=Wander(sd, few))


def with_noise_like(
    problem_of: Callable[[Windows], FitProblem], windows: Windows, values: Mapping[str, float], like: Windows
) -> Windows:
    """Return windows with the noise of commands that others of the same recorder have, at some parameters."""
    if like.wander is None or len(windows) == 0:
        return windows
    fit = _simulation(problem_of(windows), values, windows.state)
    return windows if fit.diverged else with_noise(problem_of, windows, fit, like.wander.sd)


def _simulation(problem: FitProblem, values: Mapping[str, float], state: Tensor) -> Fit:
    found, _ = problem.fit_states(values, state)
    return problem.fit([Trial("noise of the commands", (), Prior.empty(), values, found)], 1)[0]


def noise_of_commands(windows: Windows) -> tuple[float, ...]:
    """Standard deviation of the noise of each command at most, in its unit: what no smooth motion has of it."""
    found = []
    for index in range(windows.commands[0].value[:, None].reshape(len(windows.commands[0].t), -1).shape[1]):
        parts = [
            (len(c.t), _noise_of(c, index))
            for log, c in enumerate(windows.commands)
            if (windows.log == log).any() and np.ptp(c.column(index)) > 0.0
        ]
        total = sum(n for n, _ in parts)
        found.append(math.sqrt(sum(n * sd**2 for n, sd in parts) / total) if total else 0.0)
    return tuple(found)


def _noise_of(command: CommandSeries, index: int) -> float:
    """Standard deviation of the noise of a command, as independent noise of each of its rows that does the same."""
    value = command.column(index)
    changes = np.append(0, np.flatnonzero(np.diff(value) != 0.0) + 1)
    held = max(float(np.median(np.diff(changes))), 1.0) if len(changes) > 1 else 1.0
    return estimate_noise(command.t[changes], value[changes], 0.0).sd * math.sqrt(held)


def moves_by_noise(
    problem_of: Callable[[Windows], FitProblem], windows: Windows, fit: Fit, sd: Sequence[float]
) -> Tensor:
    """Return the moves (W, N, M, P) of the measurements by one standard deviation of each piece of noise.

    Commands before a window act through its initial state. Where there are many commands in it, neighbours share a
    piece, of the standard deviation of their mean.

    Args:
        problem_of: Gives the problem of such windows.
        windows: The windows.
        fit: A simulation of them.
        sd: Standard deviation of the noise of each command, in its unit.
    """
    first, last = _inside(windows, np.arange(len(windows)), windows.t0, windows.length)
    return _moves(
        problem_of, windows, fit, sd, np.arange(len(windows)), first, int((last - first).max())
    ).flatten(-2)


def _inside(
    windows: Windows, rows: np.ndarray, begin: np.ndarray, length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of the first command in each span [s] of some windows, and of the first one after it."""
    found = [
        np.searchsorted(windows.commands[windows.log[w]].t, [at - EARLY, at + length - EARLY])
        for w, at in zip(rows, begin, strict=True)
    ]
    first, last = np.array(found, dtype=int).reshape(-1, 2).T
    return first, last


def _moves(
    problem_of: Callable[[Windows], FitProblem],
    windows: Windows,
    fit: Fit,
    sd: Sequence[float],
    rows: np.ndarray,
    first: np.ndarray,
    count: int,
) -> Tensor:
    """Return the moves (R, N, M, C, P) of the measurements of some windows by noise of each of C commands.

    Args:
        problem_of, windows, fit, sd: As for :func:`moves_by_noise`.
        rows: (R,) windows.
        first: (R,) number of the first command whose noise counts.
        count: How many commands count.
    """
    exact, fit = problem_of(windows).as_fitted(fit)
    windows, theta = exact.windows, np.array([[float(fit.values[n]) for n in exact.names]])
    # Long logs have many windows, and coarser pieces keep all of them in memory.
    most = min(max(LARGEST // max(len(rows) * windows.value[0].numel() * len(sd), 1), FEWEST), PIECES)
    each = max(math.ceil(count / most), 1)
    pieces = max(math.ceil(count / each), 1)
    result = torch.zeros(len(rows), *windows.value.shape[1:], len(sd), pieces, dtype=torch.float64)
    block = max(LANES // pieces, 1)
    for index, size in enumerate(sd):
        for begin in range(0, len(rows) if size > 0.0 else 0, block):
            picked = np.arange(begin, min(begin + block, len(rows)))
            # The first of each window is the simulation that is moved, from the same commands.
            places = np.concatenate([first[picked, None], first[picked, None] + each * np.arange(pieces)], 1)
            sizes = np.append(0.0, np.full(pieces, size / math.sqrt(each)))
            of_window = np.repeat(rows[picked], pieces + 1)
            logs = windows.log[of_window]
            commands = tuple(
                _moved(windows, w, index, int(at), each, float(by))
                for w, at, by in zip(of_window, places.ravel(), np.tile(sizes, len(picked)), strict=True)
            )
            many = replace(
                windows.take(of_window),
                commands=commands,
                log=np.arange(len(of_window)),
                known=tuple(windows.known[log] for log in logs) if windows.known else (),
                stamp_sd=tuple(windows.stamp_sd[log] for log in logs) if windows.stamp_sd else (),
            )
            problem, index_of = problem_of(many), torch.from_numpy(of_window)
            shown = problem.predict(theta, fit.state[index_of][None], problem.nuisances.none()[None])[0]
            shown = shown.unflatten(0, (len(picked), pieces + 1))
            moved = shown[:, 1:] - shown[:, :1]
            moved = torch.where(torch.isfinite(moved), moved, 0.0)
            result[picked, :, :, index] = moved.permute(0, 2, 3, 1)
    return result


def _moved(windows: Windows, w: int, index: int, first: int, count: int, by: float) -> CommandSeries:
    """Return the commands that act in a window, with some of one command moved."""
    command = windows.commands[windows.log[w]]
    begin, end = windows.t0[w] - HISTORY - WARM_UP * windows.length, windows.t0[w] + windows.length
    part = slice(max(int(np.searchsorted(command.t, begin)) - 1, 0), int(np.searchsorted(command.t, end)) + 1)
    value = np.array(command.value[part], dtype=float)
    column = value if value.ndim == 1 else value[:, index]
    column[max(first - part.start, 0) : max(first - part.start + count, 0)] += by
    return CommandSeries(command.t[part], value)


def _share_of_noise(
    problem_of: Callable[[Windows], FitProblem], windows: Windows, fit: Fit, most: Sequence[float]
) -> float:
    """Return the most likely share of the largest noise of the commands, as a variance; 0 where none is believed.

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
        return 0.0
    theta = np.array([float(fit.values[n]) for n in problem.names])
    tangent = Tangent.at(problem, theta, np.zeros(0, dtype=int), fit.state)
    states = tangent.slopes(simulated(problem, [tangent], fit.nuisance[None]), problem)  # (S, W, N, M)
    asked = [s for s in SHORT if s <= int(windows.valid[:, shown].sum(-1).max())]
    answers = partial(_short_answers, problem_of, windows, fit, most, shown, states)
    # The longest stretches show the most: where they show nothing, shorter ones need not be asked.
    if not asked or not _tells(found := answers(asked[-1])):
        return 0.0
    share = _share_of_directions(found)
    if share is not None and share <= LARGER:
        return share if share >= SMALLEST else 0.0
    seen = [found]
    for short in asked[:-1]:
        seen.append(answers(short))
        if _tells(seen[-1], PLENTY):
            found = seen[-1]
            break
    found = [own for own in found if own.width.any()]
    if max(_gain(found, share) for share in SHARES) < EVIDENCE:
        return 0.0
    # Of noise of a share s, the mean power is 1 + s width. A model error is now larger and now smaller than that.
    told = [float(((own.power - 1.0) * own.width).sum() / (own.width**2).sum()) for own in found]
    share = min(float(np.median(told)), 1.0)
    return share if share >= SHARES[0] and not _felt(seen, share) else 0.0


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
    known = [
        np.array([(own.along, own.whole, own.spread) for own in each if own.spread > 0.0]).reshape(-1, 3).T
        for each in seen
    ]
    along, whole, spread = max(known, key=lambda each: float((each[1] ** 2 / each[2]).sum()))
    information = float((whole**2 / spread).sum())
    slope = float((along * whole / spread).sum()) / max(information, EARLY)
    return ((slope + share) ** 2 - slope**2) * information > FELT


def _short_answers(
    problem_of: Callable[[Windows], FitProblem],
    windows: Windows,
    fit: Fit,
    most: Sequence[float],
    shown: list[int],
    states: Tensor,
    short: int,
) -> list[Answer]:
    """Return what some samples in a row say at each place, without what their state and a smooth load explain.

    Args:
        problem_of, windows, fit, most: As for :func:`_share_of_noise`.
        shown: Channels that count.
        states: (S, W, N, M) weighted moves by the initial states.
        short: How many samples.
    """
    clock, counts = shown[0], windows.valid[:, shown].sum(-1).amin(1).numpy()
    places = [
        (w, int(at))
        for w, n in enumerate(counts)
        if n >= short
        for at in np.unique(np.linspace(0, n - short, min(PLACES, n // short)).astype(int))
    ]
    if not places:
        return []
    some = np.unique(np.linspace(0, len(places) - 1, min(MOST_PLACES, len(places))).astype(int))
    places = [places[k] for k in some]
    rows, begin = np.array(places).T
    t, weight = windows.t[:, clock].numpy(), problem_of(windows).weight
    length = float(np.median(t[rows, begin + short - 1] - t[rows, begin]))
    first, last = _inside(windows, rows, windows.t0[rows] + t[rows, begin], length)
    moves = _moves(problem_of, windows, fit, most, rows, first, int((last - first).max()))
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
        vectors, singular, right = np.linalg.svd(moved - basis @ (basis.T @ moved), full_matrices=False)
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
    vectors, singular, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    return vectors[:, singular > SAME * singular.max(initial=SAME)]
