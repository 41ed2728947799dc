"""Check a user's request for a fit, and complete it: free parameters, bounds, prior, windows."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepkoco.fit.data.per_log_differences import may_differ
from deepkoco.fit.data.windows import Windows, cut_windows, moving, window_length
from deepkoco.fit.fit import FitProblem, channel_delays
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.solve.encoder_zeros import EncoderZeros
from deepkoco.fit.solve.nuisances import Nuisances
from deepkoco.fit.solve.prior import Prior
from deepkoco.logs.held_values import with_held_values
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem, Parameter, System, any_system
from deepkoco.systems.effects import effects_of
from deepkoco.systems.effects.effect import ALL

MIN_FITTED_WINDOWS = 2


class FitError(ValueError):
    """The request for a fit is wrong: an unknown parameter, wrong bounds, too little motion."""


@dataclass(frozen=True)
class FitRequest:
    """Checked request for a fit.

    Attributes:
        system: System with all requested effects; the bounds of its parameters are those of the fit.
        windows: Windows in which the joint moves.
        free: Parameters to fit.
        late: Channels whose delay is fitted.
        start: Start value of every parameter.
        prior: Prior over the free parameters.
        zero_sd: Standard deviation of encoder zeros from log to log [rad]; None takes the channels' declarations.
        resting: Number of windows that are left out because the joint rests in them.
    """

    system: ExtendedSystem
    windows: Windows
    free: tuple[str, ...]
    late: tuple[str, ...]
    start: dict[str, float]
    prior: Prior
    zero_sd: float | None
    resting: int

    @property
    def nuisances(self) -> Nuisances:
        """Quantities of each log that are fitted along: encoder zeros, and differences of parameters that vary."""
        zeros = EncoderZeros.of(self.system, len(self.windows.commands), self.zero_sd)
        return Nuisances(zeros, self.windows.varies)

    @property
    def declared(self) -> tuple[Parameter, ...]:
        """Declarations of the free parameters, in their order."""
        known = {p.name: p for p in (*self.system.parameters, *channel_delays(self.late))}
        return tuple(known[name] for name in self.free)

    def problem(self, windows: Windows | None = None) -> FitProblem:
        """The fit problem on the windows of the request, or on other windows of the same system."""
        windows = self.windows if windows is None else windows
        if self.late:
            windows = _without_start(windows, self.late, self.system)
        return FitProblem(self.system, windows, self.late, self.zero_sd)


def known_parameters(system: System) -> tuple[Parameter, ...]:
    """All parameters that can be fitted: the system's own, those of every effect, one delay per channel."""
    base = system.base if isinstance(system, ExtendedSystem) else system
    full = ExtendedSystem(base, tuple(effects_of(base)), {p.name: p.value for p in system.parameters})
    return (*full.parameters, *channel_delays([c.name for c in system.measurements]))


def command_delays(system: System) -> tuple[str, ...]:
    """Names of the delays of a system's commands, one for each driven joint."""
    base = system.base if isinstance(system, ExtendedSystem) else system
    placed = [p for p in effects_of(base).values() if p.effect.name == "actuation_delay"]
    return tuple(f"{p.name}.delay" for p in placed if p.index != ALL)


def make_request(
    recordings: Sequence[Recording],
    system: str | System,
    parameters: Sequence[str],
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    prior: Prior | None = None,
    start: Mapping[str, float] | None = None,
    window: float | None = None,
    zero_sd: float | None = None,
    varies: Mapping[str, float] | None = None,
) -> FitRequest:
    """Check a request and cut the logs into windows. Args and Raises as :func:`deepkoco.fit.fit`."""
    base = any_system(system)
    known = {p.name: p for p in known_parameters(base)}
    free = tuple(dict.fromkeys(parameters))
    if not free:
        raise FitError(f"no parameter to fit; {base.name} has: {', '.join(p.name for p in base.parameters)}")
    for what in (free, bounds or (), start or (), prior.names if prior else (), varies or ()):
        _check_names(what, known, base)
    if prior is not None:
        _check_prior(prior)
    _check_varying(varies or {}, known, base, len(recordings), free, prior)
    late = tuple(c.name for c in base.measurements if f"{c.name}.delay" in free)
    extended = _extended(base, (*free, *(start or ()), *(varies or ())), late)
    extended.parameters = tuple(
        _bounded(p, bounds or {}, start or {}, p.name in free) for p in extended.parameters
    )
    delays = {p.name: _bounded(p, bounds or {}, start or {}, True) for p in channel_delays(late)}
    if any(bounds and name in bounds for name in delays):
        raise FitError("bounds: the delay of a channel has fixed bounds, 0 to 0.1 s; leave these bounds out")
    values = {p.name: p.value for p in (*extended.parameters, *delays.values())}
    recordings = [with_held_values(log) for log in recordings]
    windows = cut_windows(recordings, base, window_length(base) if window is None else window)
    moves = moving(windows) if len(windows) else np.zeros(0, dtype=bool)
    if moves.sum() < MIN_FITTED_WINDOWS:
        raise FitError(
            f"the joint moves in {int(moves.sum())} windows of {windows.length:.2g} s; a fit needs at least "
            f"{MIN_FITTED_WINDOWS}: record more motion, or give a shorter window"
        )
    kept = replace(windows.take(moves), varies=dict(varies or {}))
    if varies and len(np.unique(kept.log)) < 2:
        raise FitError(
            f"varies: {', '.join(varies)}: the joint moves in only one log; a difference between logs needs two"
        )
    kept = _without_start(kept, late, base) if late else kept
    values |= {name: p.value for name, p in Push.declared(extended, kept).items()}
    found = {p.name: p for p in (*extended.parameters, *delays.values())}
    _check_bounded([found[name] for name in free if prior is None or name not in prior.names])
    chosen = _completed(prior, [found[name] for name in free])
    return FitRequest(extended, kept, free, late, values, chosen, zero_sd, int((~moves).sum()))


def wide(parameters: Iterable[Parameter]) -> Prior:
    """Wide prior: its standard deviation is half the distance between the bounds."""
    return Prior.of([replace(p, prior_sd=0.5 * (p.high - p.low)) for p in parameters])


def _completed(prior: Prior | None, free: Sequence[Parameter]) -> Prior:
    """Prior over all free parameters; those that ``prior`` does not contain get a wide one."""
    rest = [p for p in free if prior is None or p.name not in prior.names]
    if prior is None:
        return wide(rest)
    index = [prior.names.index(p.name) for p in free if p.name in prior.names]
    added = wide(rest)
    size, count = len(index), len(rest)
    covariance = np.zeros((size + count, size + count))
    covariance[:size, :size] = prior.covariance[np.ix_(index, index)]
    covariance[size:, size:] = added.covariance
    names = tuple(prior.names[i] for i in index) + added.names
    return Prior(names, np.concatenate([prior.centre[index], added.centre]), covariance)


def _check_names(names: Iterable[str], known: Mapping[str, Parameter], system: System) -> None:
    for name in names:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=3, cutoff=0.4)
            # With several joints, "coulomb" and "coulomb.torque" stand for "coulomb(joint 1).torque" and so on.
            close += [k for k in known if k.startswith(f"{name}.") or k.endswith(f".{name}")]
            close += [k for k in known if re.sub(r"\(.*\)", "", k).startswith(name) and "(" in k]
            said = f"; did you mean {' or '.join(dict.fromkeys(close))}?" if close else ""
            own = ", ".join(p.name for p in system.parameters)
            raise FitError(
                f'{system.name} has no parameter "{name}"{said} Its own are {own}; those of effects are '
                'listed by "deepkoco systems --effects"'
            )


def _check_prior(prior: Prior) -> None:
    for name, mean, variances in zip(prior.names, prior.centre, prior.covariance, strict=True):
        if not (np.isfinite(mean) and np.isfinite(variances).all()):
            raise FitError(
                f"prior: {name}: its mean and its covariances must be finite; leave it out for a wide prior"
            )


def _check_bounded(parameters: Sequence[Parameter]) -> None:
    """Check the parameters whose prior is as wide as their bounds."""
    for parameter in parameters:
        if not np.isfinite(parameter.high - parameter.low):
            raise FitError(
                f"{parameter.name}: bounds {parameter.low:g} to {parameter.high:g} {parameter.unit}: a fit needs "
                "finite ones; give bounds, or a prior"
            )


def _check_varying(
    varies: Mapping[str, float],
    known: Mapping[str, Parameter],
    system: System,
    logs: int,
    free: Sequence[str],
    prior: Prior | None,
) -> None:
    able = may_differ(system)
    for name, sd in varies.items():
        if name not in able:
            raise FitError(
                f"varies: {name} cannot differ from log to log; only parameters of {system.name} itself and of "
                "effects on its body and joints can"
            )
        if not 0.0 < sd < np.inf:
            raise FitError(
                f"varies: {name}: the standard deviation {sd:g} {known[name].unit} must be positive and finite"
            )
    if prior is not None and (lost := [n for n in prior.names if n in varies and n not in free]):
        raise FitError(
            f"prior: {', '.join(lost)}: varies, but is not among the parameters to fit; fit it too, or give its mean "
            "as start value"
        )
    if varies and logs < 2:
        raise FitError(
            f"varies: {', '.join(varies)}: a difference between logs needs at least two logs; give more logs"
        )


def _extended(base: System, names: Iterable[str], late: Sequence[str]) -> ExtendedSystem:
    had = tuple(e.name for e in base.effects) if isinstance(base, ExtendedSystem) else ()
    delays = {f"{c}.delay" for c in late}
    asked = tuple(name.split(".")[0] for name in names if "." in name and name not in delays)
    plain = base.base if isinstance(base, ExtendedSystem) else base
    return ExtendedSystem(plain, (*had, *asked), {p.name: p.value for p in base.parameters})


def _bounded(
    parameter: Parameter,
    bounds: Mapping[str, tuple[float, float]],
    start: Mapping[str, float],
    free: bool,
) -> Parameter:
    low, high = bounds.get(parameter.name, (parameter.low, parameter.high))
    where = f"{parameter.name}: bounds {low:g} to {high:g} {parameter.unit}"
    if not low < high:
        raise FitError(f"{where}: the lower one must be below the upper one")
    if low < parameter.low or high > parameter.high:
        raise FitError(f"{where} exceed the admissible range, {parameter.low:g} to {parameter.high:g}")
    if parameter.name not in start:
        return replace(parameter, low=low, high=high, value=float(np.clip(parameter.value, low, high)))
    value = float(start[parameter.name])
    if not low <= value <= high:
        raise FitError(f"{parameter.name}: start {value:g} {parameter.unit} is outside {low:g} to {high:g}")
    return replace(parameter, low=low, high=high, value=value)


def _without_start(windows: Windows, late: Sequence[str], system: System) -> Windows:
    """Leave out samples of late channels that may show a state before the start of their window."""
    valid = windows.valid.clone()
    for c, channel in enumerate(system.measurements):
        if channel.name in late:
            longest = channel_delays([channel.name])[0].high
            valid[:, c] &= windows.t[:, c] >= longest
    return replace(windows, valid=valid)
