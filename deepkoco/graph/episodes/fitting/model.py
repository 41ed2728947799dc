"""A delay model fitted from a recording in one call."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import ndtri
from scipy.stats import rankdata, spearmanr

from deepkoco.graph.delay import (
    Autoregressive,
    Delay,
    DelayError,
    Empirical,
    Lossy,
    OrnsteinUhlenbeck,
    RankCorrelation,
    Stalls,
    make_correlation,
    make_delay,
    make_stalls,
)
from deepkoco.graph.episodes.fitting.mixture_fit import fit_mixture
from deepkoco.graph.episodes.fitting.stall_detection import FoundStall, find_stalls, fit_stalls

_SURE = 4.0  # a correlation counts from this many standard errors on
_IRREGULAR = 0.2  # spread of the times between samples, over their mean, from which they are irregular


class FitError(ValueError):
    """Recorded delays that no model can be fitted to; the message names the channel."""


@dataclass(frozen=True)
class DelayModel:
    """Laws of all channels and what ties them together; goes into `draw_timing` or a `Graph`.

    Attributes:
        laws: by node name (computation) and connection key (communication).
        correlations: between channels of one publisher.
        stalls: shared by all channels.
        found: the stalls that were seen.
    """

    laws: dict[str, Delay]
    correlations: tuple[RankCorrelation, ...] = ()
    stalls: tuple[Stalls, ...] = ()
    found: tuple[FoundStall, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Describe the model in plain numbers, strings and lists; without the stalls that were seen."""
        return {
            "laws": {key: law.to_dict() for key, law in self.laws.items()},
            "correlations": [correlation.to_dict() for correlation in self.correlations],
            "stalls": [stalls.to_dict() for stalls in self.stalls],
        }

    @classmethod
    def from_dict(cls, description: Mapping[str, Any]) -> "DelayModel":
        """Build the model that `to_dict` described."""
        return cls(
            {key: make_delay(law) for key, law in description["laws"].items()},
            tuple(map(make_correlation, description.get("correlations", ()))),
            tuple(map(make_stalls, description.get("stalls", ()))),
        )


def fit_delays(
    recording: Any,
    rates: Mapping[str, float] | None = None,
    *,
    times: Mapping[str, np.ndarray] | None = None,
    publishers: Mapping[str, str] | None = None,
    family: str = "mixture",
    warm_up: float = 0.0,
    tolerance: float = 0.5,
) -> DelayModel:
    """Fit the delays of a recording: a law for each channel, correlations, and shared stalls.

    1. Stalls are found across channels, and the samples that they held up are set aside.
    2. Each channel gets a mixture (family and size by BIC) or its samples as an empirical law, with the
       share of lost messages, and the correlation of the normal scores from one sample to the next; where the
       samples come at irregular times, the time constant with which the scores forget.
    3. Channels of one publisher get the rank correlation of samples with the same number.

    Args:
        recording: an `Episode`, a `MeasuredTiming`, or delays (n,) [s] by channel: node name (computation)
            or "sender->receiver" (communication), infinite where a message got lost.
        rates: for bare arrays, samples a second by channel; None: all channels span the same time, counted
            in samples of the longest.
        times: of bare arrays, stamps (n,) [s] by channel in the place of a rate.
        publishers: node behind each channel whose name does not tell it.
        family: "mixture" or "empirical".
        warm_up: seconds at the begin that are left out.
        tolerance: how far apart the clocks of channels are at most [s].

    Raises:
        FitError: a channel is too short, or holds what is no delay.
    """
    if family not in ("mixture", "empirical"):
        raise FitError(f'family "{family}" is none of mixture, empirical')
    delays, times = _samples(recording, rates, times or {})
    for key in delays:
        kept = times[key] >= warm_up
        delays[key], times[key] = delays[key][kept], times[key][kept]
        _check(key, delays[key])
    arrived = {key: np.isfinite(delay) for key, delay in delays.items()}
    found = find_stalls(
        {key: delay[arrived[key]] for key, delay in delays.items()},
        {key: time[arrived[key]] for key, time in times.items()},
        tolerance,
    )
    span = max(float(time[-1] - time[0]) for time in times.values())
    stalls = fit_stalls(found, span)
    usual = {key: arrived[key].copy() for key in delays}
    for stall in found:
        for key, samples in stall.hit.items():
            usual[key][np.flatnonzero(arrived[key])[samples]] = False
    laws: dict[str, Delay] = {}
    for key, delay in delays.items():
        clean = delay[usual[key]]
        law = fit_mixture(clean) if family == "mixture" else Empirical(tuple(clean.tolist()))
        factor = _autocorrelation(delay, usual[key])
        seconds = None if law.constant else time_constant(delay, usual[key], times[key])
        if seconds is not None:
            law = OrnsteinUhlenbeck(law, seconds)
        elif not law.constant and abs(factor) > _SURE / np.sqrt(len(clean)):
            law = Autoregressive(law, float(np.clip(factor, -0.99, 0.99)))
        lost = 1.0 - arrived[key].mean()
        laws[key] = Lossy(law, float(lost)) if lost > 0 else law
    periods = {key: float(np.median(np.diff(time))) for key, time in times.items()}
    correlations = _correlations(delays, usual, laws, publishers or {}, periods)
    return DelayModel(laws, correlations, () if stalls is None else (stalls,), tuple(found))


def _samples(
    recording: Any, rates: Mapping[str, float] | None, stamps: Mapping[str, np.ndarray]
) -> tuple[dict, dict]:
    measured = getattr(recording, "measured", recording)
    if isinstance(measured, Mapping):
        delays = {key: np.array(delay, dtype=np.float64) for key, delay in measured.items()}
        if not delays:
            raise FitError("the recording has no channel")
        for key, delay in delays.items():
            if delay.ndim != 1:
                raise FitError(f'"{key}": delays have shape {delay.shape}; expected one number a sample')
            if key in stamps:
                given = np.asarray(stamps[key], dtype=np.float64)
                if given.shape != delay.shape or not (np.diff(given) > 0).all():
                    raise FitError(
                        f'"{key}": times must be {len(delay)} growing stamps [s], one for each delay'
                    )
            elif rates is not None and not (key in rates and 0 < rates[key] < np.inf):
                raise FitError(f'"{key}": no rate, or one that is not positive; give samples a second')
        longest = max(len(delay) for delay in delays.values())
        known = {} if rates is None else rates
        step = {k: 1 / known[k] if k in known else longest / max(len(d), 1) for k, d in delays.items()}
        regular = {key: step[key] * np.arange(len(delay)) for key, delay in delays.items()}
        return delays, regular | {
            key: np.asarray(t, dtype=np.float64) for key, t in stamps.items() if key in delays
        }
    delays, times = {}, {}
    outputs = getattr(recording, "outputs", {})
    for name, end in measured.t_end.items():
        # The last step of a supervisor only starts: it has sent nothing, and no end that was measured.
        start = measured.t_start[name][: len(outputs[name]) if name in outputs else len(end)]
        delays[name], times[name] = np.asarray(end)[: len(start)] - start, np.asarray(start)
    for key, received in measured.t_received.items():
        sent = np.asarray(measured.t_end[key.split("->")[0]])[: len(received)]
        delays[key], times[key] = np.asarray(received)[: len(sent)] - sent, sent
    return delays, times


def _check(key: str, delay: np.ndarray) -> None:
    wrong = np.flatnonzero(~(delay >= 0))
    if len(wrong):
        raise FitError(f'"{key}": sample {wrong[0]} is {delay[wrong[0]]} s; delays are numbers >= 0')
    arrived = int(np.isfinite(delay).sum())
    if arrived < 10:
        raise FitError(f'"{key}": {arrived} delays after the warm-up; at least 10 wanted')
    if "->" not in key and arrived < len(delay):
        raise FitError(f'"{key}": sample {np.flatnonzero(np.isinf(delay))[0]} is infinite; a step has an end')


def normal_scores(delay: np.ndarray) -> np.ndarray:
    """Return the standard normal quantiles of the ranks, (n,)."""
    return ndtri((rankdata(delay) - 0.5) / len(delay))


def _autocorrelation(delay: np.ndarray, usual: np.ndarray) -> float:
    scores = np.zeros(len(delay))
    scores[usual] = normal_scores(delay[usual])
    pairs = usual[1:] & usual[:-1]
    before, after = scores[:-1][pairs], scores[1:][pairs]
    if len(before) < 3 or before.std() == 0 or after.std() == 0:
        return 0.0
    return float(np.corrcoef(before, after)[0, 1])


def time_constant(delay: np.ndarray, usual: np.ndarray, time: np.ndarray) -> float | None:
    """Time constant [s] with which the normal scores of delays forget, by maximum likelihood.

    An Ornstein-Uhlenbeck process seen at any stamps: z_{k+1} given z_k is normal with mean a z_k and variance
    1 - a^2, a = exp(-(t_{k+1} - t_k) / time_constant).

    Args:
        delay: (n,) [s].
        usual: (n,) which samples count.
        time: (n,) stamps [s].

    Returns:
        None where stamps are regular (one correlation says it all) or nothing is sure to be correlated.
    """
    pairs = usual[1:] & usual[:-1]
    gap = np.diff(time[: len(delay)])[pairs]
    if len(gap) < 10 or (gap <= 0).any() or np.std(gap) < _IRREGULAR * np.mean(gap):
        return None
    scores = np.zeros(len(delay))
    scores[usual] = normal_scores(delay[usual])
    before, after = scores[:-1][pairs], scores[1:][pairs]

    def cost(log_seconds: float) -> float:
        factor = np.exp(-gap / np.exp(log_seconds))
        variance = -np.expm1(2.0 * np.log(np.maximum(factor, 1e-300)))
        return float((np.log(variance) + (after - factor * before) ** 2 / variance - after**2).sum())

    # From forgetting within the shortest of gaps to remembering through hundreds.
    grid = np.log(np.median(gap)) + np.linspace(np.log(0.05), np.log(300.0), 60)
    best = int(np.argmin([cost(x) for x in grid]))
    ends = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    found: Any = minimize_scalar(cost, bounds=ends, method="bounded")
    return float(np.exp(found.x)) if found.fun < -(_SURE**2) else None


def _correlations(
    delays: dict[str, np.ndarray],
    usual: dict[str, np.ndarray],
    laws: dict[str, Delay],
    publishers: Mapping[str, str],
    periods: Mapping[str, float],
) -> tuple[RankCorrelation, ...]:
    groups: dict[str, list[str]] = {}
    for key in delays:
        if not laws[key].constant:
            groups.setdefault(publishers.get(key, key.split("->")[0]), []).append(key)
    found = []
    for channels in groups.values():
        size = len(channels)
        matrix, sure = np.eye(size), np.zeros((size, size), dtype=np.bool_)
        for i in range(size):
            for j in range(i):
                a, b = channels[i], channels[j]
                n = min(len(delays[a]), len(delays[b]))
                both = usual[a][:n] & usual[b][:n]
                if both.sum() < 10:
                    continue
                rho = float(spearmanr(delays[a][:n][both], delays[b][:n][both]).statistic)  # pyright: ignore[reportAttributeAccessIssue]
                sure[i, j] = sure[j, i] = abs(rho) > _SURE / np.sqrt(both.sum())
                matrix[i, j] = matrix[j, i] = rho if sure[i, j] else 0.0
        kept = np.flatnonzero(sure.any(axis=1))
        if len(kept):
            names = tuple(channels[i] for i in kept.tolist())
            found.append(_joint(names, matrix[np.ix_(kept, kept)], laws, periods))
    return tuple(found)


def _joint(
    names: tuple[str, ...], matrix: np.ndarray, laws: dict[str, Delay], periods: Mapping[str, float]
) -> RankCorrelation:
    """Weaken correlations that were estimated pair by pair until there is a joint law with them."""
    factors = np.array([_plain(laws[name]).autocorrelation(periods[name]) for name in names])
    for _ in range(200):
        try:
            correlation = RankCorrelation(names, tuple(map(tuple, matrix.tolist())))
            correlation.roots(factors)
        except DelayError:
            matrix = np.where(np.eye(len(names), dtype=np.bool_), 1.0, 0.98 * matrix)
        else:
            return correlation
    raise FitError(f"no joint law of {' and '.join(names)} has their correlations")


def _plain(law: Delay) -> Delay:
    return law.delay if isinstance(law, Lossy) else law
