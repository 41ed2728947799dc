"""Parameters of a system from recordings, in one call."""

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
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem, System


def fit(
    recordings: Sequence[Recording],
    system: str | System,
    parameters: Sequence[str],
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
    """Find parameters of a system from recordings of it.

    The logs are cut into windows, each simulated from an initial state of its own under the logged commands; the
    parameters are those under which the simulations are closest to the measurements, in noise standard
    deviations. Found besides, per log and window: initial states, the encoder's zero where it is unknown, and what the
    log has of its own of parameters that vary.

    Args:
        recordings: Logs of one unit.
        system: Name of the system, or a system.
        parameters: What to find: the system's own parameters (``mass``), those of effects
            (``actuation_delay.delay``, ``coulomb.torque``; of one joint of several ``coulomb(joint 2).torque``), or
            the delay of one channel (``theta.delay``).
        method: Levenberg-Marquardt unless given.
        bounds: Parameter -> lowest and highest value; those declared where not given.
        prior: Gaussian prior over some of the parameters; very wide over the others.
        start: Parameter -> value at the start, also of parameters that are not found but known.
        window: Length of a window [s]; None takes about one period of the system.
        zero_sd: Spread of the angle sensor's zero from log to log [rad]; None takes the system's, 0 is a known
            zero.
        varies: Parameter -> standard deviation by which it varies from log to log, in its unit: every log has its
            own, and what is found is the mean of all (random effects). The system's own parameters and those of
            effects on its body and joints may vary.
        seed: Seed of the method's draws.
        progress: Called with stage, iteration, most iterations and cost.

    Raises:
        FitError: A parameter is unknown or cannot vary, its bounds or start are wrong, there is too little motion, or
            the simulation diverges at the start.
        LogError: A log lacks a channel.
        UnknownSystemError: There is no such system.
    """
    began = time.perf_counter()
    method = LevenbergMarquardt() if method is None else method
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
            # As if nobody knew yet that logs differ.
            shared = replace(
                solution.request,
                windows=replace(solution.request.windows, varies={}),
            )
            zero = solution.fit.nuisance[: request.nuisances.zeros.count]
            before = held(shared, request.start, solution.fit.state, zero)
        except FloatingPointError as error:
            raise FitError(
                f"the simulation diverges at the start values; give others, or shorter windows ({error})"
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
    return _identification(solution, before, convergence, logs, seed)


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
        _own(solution, joint),
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
    """Covariance of parameters and nuisances, and what the data alone say about the parameters.

    In units of the priors' standard deviations: parameters of unlike size are inverted to full precision. What the
    residuals are short of noise lowers what the data say, not what is known without them.
    """
    count, full = len(request.free), found.curvature
    index = [request.prior.names.index(n) for n in request.free]
    sd = np.sqrt(np.diag(request.prior.covariance))[index]
    sd = np.concatenate([sd, request.nuisances.spread])
    before = np.zeros_like(full)
    before[:count, :count] = request.prior.precision(request.free)
    before[count:, count:] = np.diag(1.0 / request.nuisances.spread**2)
    weighed = before + (full - before) / deflation
    values, vectors = np.linalg.eigh(weighed * np.outer(sd, sd))
    # The prior alone gives eigenvalues near 1 or above; less is rounding.
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
        result.append(Estimate(name, value, low, high, sd, "rad", 0.0, (-np.inf, np.inf)))
    return tuple(result)


def _own(solution: MethodResult, covariance: np.ndarray) -> tuple[Estimate, ...]:
    """Parameters that vary, of every log: the mean, and what the log differs by."""
    request, fit = solution.request, solution.fit
    declared = {p.name: p for p in request.system.parameters}
    result = []
    for name in request.nuisances.varies:
        # A log in which nothing moves says nothing.
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
