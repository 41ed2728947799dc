"""Fit parameters of a system to recordings in one call."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from deepkoco.fit.fit_types import Fit
from deepkoco.fit.identification import Convergence, Estimate, Identification, interval
from deepkoco.fit.request import FitError, FitRequest, make_request
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.identifiability import unidentified
from deepkoco.fit.solve.methods import LevenbergMarquardt, Method, MethodResult, Progress, held
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.threads import one_thread
from deepkoco.logs.read_logs import Logs, read_logs
from deepkoco.systems import ExtendedSystem, System, any_system


def fit(
    recordings: Logs,
    system: str | System,
    parameters: Sequence[str] | None = None,
    *,
    method: Method | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    prior: Prior | None = None,
    start: Mapping[str, float] | None = None,
    window: float | None = None,
    zero_sd: float | None = None,
    varies: Mapping[str, float] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Identification:
    """Fit parameters of a system to recordings of it.

    The logs are cut into windows. Each window is simulated from its own initial state under the logged commands. The
    fit minimises the squared simulation errors in noise standard deviations. It also fits the initial state of each
    window, unknown encoder zeros of each log, and each log's differences of parameters that vary.

    Args:
        recordings: Logs of one unit: recordings, paths of logs, or folders of logs.
        system: Name of the system, or a system.
        parameters: Parameters to fit: the system's own (``mass``), those of effects
            (``actuation_delay.delay``, ``coulomb.torque``; of one joint of several ``coulomb(joint 2).torque``), or
            the delay of one channel (``theta.delay``). None takes all parameters of the system.
        method: None takes Levenberg-Marquardt.
        bounds: Parameter -> lowest and highest value; None takes the declared bounds.
        prior: Gaussian prior over some of the parameters; the others get a wide prior.
        start: Parameter -> start value; for a parameter that is not fitted, its known value.
        window: Length of a window [s]; None takes about one period of the system.
        zero_sd: Standard deviation of the angle sensor's zero from log to log [rad]; None takes the system's, 0 is a
            known zero.
        varies: Parameter -> standard deviation between logs, in its unit. Each log has its own value around a common
            mean, which is fitted (random effects). The system's own parameters and those of effects on its body and
            joints can vary.
        seed: Seed of the method's draws.
        progress: Called with stage, iteration, largest number of iterations and cost.

    Raises:
        FitError: A parameter is unknown or cannot vary, or its bounds or start value are wrong. The joint moves too
            little, or the simulation diverges at the start values.
        LogError: A log cannot be read, or lacks a channel.
        UnknownSystemError: There is no such system.
    """
    began = time.perf_counter()
    method = LevenbergMarquardt() if method is None else method
    recordings = read_logs(recordings, system)
    if parameters is None:
        parameters = [p.name for p in any_system(system).parameters]
    with one_thread():
        request = make_request(
            recordings,
            system,
            parameters,
            bounds=bounds,
            prior=prior,
            start=start,
            window=window,
            zero_sd=zero_sd,
            varies=varies,
        )
        try:
            solution = method.solve(request, np.random.default_rng(seed), progress or _quiet)
            # Before the fit, the differences of the logs are unknown: all logs share the start values.
            shared = replace(
                solution.request,
                windows=replace(solution.request.windows, varies={}),
            )
            zero = solution.fit.nuisance[: request.nuisances.zeros.count]
            before = held(shared, request.start, solution.fit.state, zero)
        except FloatingPointError as error:
            raise FitError(
                f"the simulation diverges at the start values; give other ones or shorter windows ({error})"
            ) from error
    convergence = Convergence(
        method.name,
        solution.converged,
        solution.reason,
        solution.stages,
        solution.simulations,
        time.perf_counter() - began,
    )
    logs = tuple(r.path.name if r.path else None for r in recordings)
    warnings = tuple(text for r in recordings for text in r.warnings)
    return replace(_identification(solution, before, convergence, logs, seed), warnings=warnings)


def _quiet(stage: str, iteration: int, most: int, cost: float) -> None:
    pass


def _identification(
    solution: MethodResult, before: Fit, convergence: Convergence, logs: tuple[str | None, ...], seed: int
) -> Identification:
    found, request = solution.fit, solution.request
    spread = dispersion(found, request.windows)
    count = len(request.free)
    joint, information = _inverted(request, found, spread.deflation)
    covariance = joint[:count, :count]
    estimates = {}
    for i, declared in enumerate(request.declared):
        sd, bounds = float(np.sqrt(max(covariance[i, i], 0.0))), (declared.low, declared.high)
        value = found.values[declared.name]
        estimates[declared.name] = Estimate(
            declared.name,
            value,
            *interval(value, sd, bounds),
            sd,
            declared.unit,
            request.start[declared.name],
            bounds,
        )
    return Identification(
        _fitted(request, found.values),
        estimates,
        _zeros(solution, joint[count:, count:]),
        _values_of_logs(solution, joint),
        covariance,
        unidentified(replace(found, information=information), request.prior),
        spread,
        convergence,
        request,
        found,
        before,
        logs,
        seed,
    )


def _fitted(request: FitRequest, values: Mapping[str, float]) -> ExtendedSystem:
    own = request.system
    names = tuple(e.name for e in own.effects)
    return ExtendedSystem(own.base, names, {p.name: values[p.name] for p in own.parameters})


def _inverted(request: FitRequest, found: Fit, deflation: float) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of parameters and nuisances, and information of the data about the parameters.

    The curvature is inverted in units of the priors' standard deviations, because parameters differ in size.
    The deflation divides the information of the data, not that of the priors.
    """
    count, full = len(request.free), found.curvature
    index = [request.prior.names.index(n) for n in request.free]
    sd = np.sqrt(np.diag(request.prior.covariance))[index]
    sd = np.concatenate([sd, request.nuisances.spread])
    before = np.zeros_like(full)
    before[:count, :count] = request.prior.precision(request.free)
    before[count:, count:] = np.diag(1.0 / request.nuisances.spread**2)
    weighed = before + (full - before) / deflation
    if not np.isfinite(weighed * np.outer(sd, sd)).all():
        raise FitError(
            f"the curvature of the fit is not finite at the estimate, so {', '.join(request.free)} get no intervals; "
            "give narrower bounds, a finite prior or shorter windows"
        )
    values, vectors = np.linalg.eigh(weighed * np.outer(sd, sd))
    # The prior alone gives eigenvalues of at least about 1; smaller ones are rounding errors.
    inverse = (vectors / values.clip(1e-3)) @ vectors.T
    information = full[:count, :count] - request.prior.precision(request.free)
    if len(full) > count:
        across = full[:count, count:]
        information = information - across @ np.linalg.solve(full[count:, count:], across.T)
    return inverse * np.outer(sd, sd), information


def _zeros(solution: MethodResult, covariance: np.ndarray) -> tuple[Estimate, ...]:
    result, zeros = [], solution.request.nuisances.zeros
    for k in range(zeros.count):
        value, sd = float(solution.fit.nuisance[k]), float(np.sqrt(covariance[k, k]))
        low, high = interval(value, sd, (-np.inf, np.inf))
        name = zeros.name(k, solution.request.system)
        unit = zeros.unit(k, solution.request.system)
        result.append(Estimate(name, value, low, high, sd, unit, 0.0, (-np.inf, np.inf)))
    return tuple(result)


def _values_of_logs(solution: MethodResult, covariance: np.ndarray) -> tuple[Estimate, ...]:
    """Value in each log of every parameter that varies: common mean plus difference of the log."""
    request, fit = solution.request, solution.fit
    declared = {p.name: p for p in request.system.parameters}
    result = []
    for name in request.nuisances.varies:
        # Logs without a window in which the joint moves have no estimate.
        for log in np.unique(request.windows.log).tolist():
            k = request.nuisances.index(name, log)
            direction = np.zeros(len(covariance))
            direction[len(request.free) + k] = 1.0
            if name in request.free:
                direction[request.free.index(name)] = 1.0
            value = fit.values[name] + float(fit.nuisance[k])
            sd = float(np.sqrt(direction @ covariance @ direction))
            bounds = declared[name].low, declared[name].high
            low, high = interval(value, sd, bounds)
            unit, start = declared[name].unit, request.start[name]
            result.append(Estimate(f"{name} of log {log + 1}", value, low, high, sd, unit, start, bounds))
    return tuple(result)
