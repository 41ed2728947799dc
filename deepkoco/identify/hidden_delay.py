"""The distribution of a delay that nobody measured, from how the joint moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import minimize

from deepkoco.graph.delay import Delay, Deterministic, Gaussian, Mixture
from deepkoco.identify.fit import FitProblem
from deepkoco.identify.identification import NORMAL_95, Identification
from deepkoco.identify.levenberg_marquardt import PARAMETER_STEP
from deepkoco.identify.methods import TOLERANCE
from deepkoco.identify.question import FitError
from deepkoco.identify.threads import one_thread
from deepkoco.identify.trial import Fit, Trial
from deepkoco.identify.windows import CommandSeries

SHIFT = 1e-3  # finite difference of one message's delay [s]
SMALLEST_SPREAD = 2e-5  # of a component [s]
ROUNDS = 3  # linearisations about the delays found so far
SWEEPS, WARM_UP = 600, 200
DELAY = "actuation_delay.delay"


@dataclass(frozen=True)
class HiddenDelays:
    """Law of the delay of a log's command messages.

    Attributes:
        law: The distribution, as the delay graph takes it.
        means: (C,) means of its components [s], ascending.
        spreads: (C,) their standard deviations [s].
        weights: (C,) their shares.
        mean_interval: 95 % interval of the overall mean [s].
        spread_interval: 95 % interval of the standard deviation [s]; of a single component only, else NaN.
        evidence: Twice the gain of the log marginal likelihood by one normal law over a constant delay; above
            about 10 the delay varies beyond doubt.
        sent: (K,) instants at which the messages that changed the command were sent [s], log after log.
        log: (K,) log of each.
        delay: (K,) posterior mean of each message's delay [s].
        delay_sd: (K,) its posterior standard deviation [s].
    """

    law: Delay
    means: np.ndarray
    spreads: np.ndarray
    weights: np.ndarray
    mean_interval: tuple[float, float]
    spread_interval: tuple[float, float]
    evidence: float
    sent: np.ndarray
    log: np.ndarray
    delay: np.ndarray
    delay_sd: np.ndarray

    @property
    def mean(self) -> float:
        """Mean delay [s]."""
        return float(self.weights @ self.means)

    @property
    def spread(self) -> float:
        """Standard deviation of the delay [s]."""
        return math.sqrt(float(self.weights @ (self.spreads**2 + self.means**2)) - self.mean**2)


def hidden_delays(found: Identification, components: int = 1, seed: int = 0) -> HiddenDelays:
    r"""Recover the distribution of the commands' delays by marginal likelihood.

    A command that acts eps later than usual gives the joint, to first order, a known impulse. With every window's
    initial state left free, the residuals r are linear in the delays of its messages, r = G eps + J x + noise; the
    states x (and with them all but A = G' P G and h = G' P r) are projected out. Under a normal law of eps the
    marginal likelihood is closed-form and maximised directly. A mixture adds the component of each message; the law
    then follows from stochastic-approximation EM with Gibbs draws of components and delays. Dynamics and delays take
    turns: parameters are fitted again under the messages' posterior mean delays, and the residuals linearised there.

    Args:
        found: A fit; the delay of the commands is best among what it found. Messages are taken to keep their order.
        components: Normal components of the law.
        seed: Of the Gibbs draws.

    Raises:
        FitError: No command changes in the windows, or there are too few changes for so many components.

    Source: Delyon, Lavielle, Moulines, Convergence of a stochastic approximation version of the EM algorithm (1999).
    """
    if components < 1:
        raise FitError(f"components: {components}; a law has at least one")
    generator = np.random.default_rng(seed)
    with one_thread():
        messages = _Messages(found)
        if len(messages.sent) < 10 * components:
            raise FitError(
                f"{len(messages.sent)} commands change inside the windows; a delay law of {components} components "
                f"needs at least {10 * components}: record with an excitation that changes often (prbs)"
            )
        shift = np.zeros(len(messages.sent))
        fit, values = found.fit, found.fit.values
        for _ in range(ROUNDS):
            linear = messages.linearise(fit, shift)
            single = _normal_law(linear)
            posterior = linear.posterior(np.full(len(shift), single[0]), np.full(len(shift), single[1]))
            if components > 1:
                means, spreads, weights, posterior = _mixture_law(linear, components, generator)
            shift = posterior[0]
            fit = messages.refit(values, shift, fit)
            values = fit.values
    base = values.get(DELAY, 0.0)
    if components == 1:
        means, spreads, weights = np.array([single[0]]), np.array([single[1]]), np.ones(1)
    order = np.argsort(means)
    means, spreads, weights = base + means[order], spreads[order], weights[order]
    reach = NORMAL_95 * single[2]
    spread_interval = (
        single[1] * math.exp(-NORMAL_95 * single[3]),
        single[1] * math.exp(NORMAL_95 * single[3]),
    )
    overall = float(weights @ means)
    return HiddenDelays(
        _law(means, spreads, weights),
        means,
        spreads,
        weights,
        (overall - reach, overall + reach),
        spread_interval if components == 1 else (math.nan, math.nan),
        single[4],
        messages.sent,
        messages.log,
        base + posterior[0],
        posterior[1],
    )


def _law(means: np.ndarray, spreads: np.ndarray, weights: np.ndarray) -> Delay:
    parts = [
        Gaussian(max(m, 0.0), s) if s > SMALLEST_SPREAD else Deterministic(max(m, 0.0))
        for m, s in zip(means.tolist(), spreads.tolist(), strict=True)
    ]
    return parts[0] if len(parts) == 1 else Mixture(tuple(parts), tuple(weights.tolist()))


@dataclass(frozen=True)
class _Linear:
    """Likelihood of the messages' delays, window by window: exp(-eps' A eps / 2 + h' eps)."""

    members: Sequence[np.ndarray]  # per window, its messages
    information: Sequence[np.ndarray]  # A
    pull: Sequence[np.ndarray]  # h

    def posterior(self, mean: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Posterior means and standard deviations under independent normal priors (K,)."""
        centre, spread = mean.copy(), sd.copy()
        for own, a, h in zip(self.members, self.information, self.pull, strict=True):
            covariance = np.linalg.inv(a + np.diag(sd[own] ** -2))
            centre[own] = covariance @ (h + mean[own] / sd[own] ** 2)
            spread[own] = np.sqrt(np.diag(covariance))
        return centre, spread

    def draw(self, mean: np.ndarray, sd: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """One draw (K,) of the delays under independent normal priors."""
        result = mean + sd * generator.standard_normal(len(mean))
        for own, a, h in zip(self.members, self.information, self.pull, strict=True):
            root = np.linalg.cholesky(a + np.diag(sd[own] ** -2))
            white = np.linalg.solve(root, h + mean[own] / sd[own] ** 2) + generator.standard_normal(len(own))
            result[own] = np.linalg.solve(root.T, white)
        return result

    def log_marginal(self, mean: float, sd: float) -> float:
        """Log marginal likelihood of one normal law, up to a constant."""
        total = 0.0
        for a, h in zip(self.information, self.pull, strict=True):
            # About the mean: eps = mean + sd z with z standard normal.
            ones = np.full(len(a), mean)
            left = h - a @ ones
            inner = np.eye(len(a)) + sd**2 * a
            total += float(ones @ h - 0.5 * ones @ a @ ones)
            total += 0.5 * sd**2 * float(left @ np.linalg.solve(inner, left))
            total -= 0.5 * float(np.linalg.slogdet(inner)[1])
        return total


class _Messages:
    """The command messages that act inside the windows of a fit."""

    def __init__(self, found: Identification) -> None:
        self.question = found.question
        self.windows = found.question.windows
        base = found.fit.values.get(DELAY, 0.0)
        sent, log, index, members = [], [], [], [[] for _ in range(len(self.windows))]
        for number, command in enumerate(self.windows.commands):
            value = command.value.reshape(len(command.t), -1)
            changed = 1 + np.flatnonzero((np.diff(value, axis=0) != 0).any(1))
            for w in np.flatnonzero(self.windows.log == number):
                begin = self.windows.t0[w]
                acts = command.t[changed] + base
                # A message that may act before its window, or too late in it to be seen, tells nothing there.
                inside = changed[(acts > begin) & (acts < begin + self.windows.length)]
                for k in inside:
                    members[w].append(len(sent))
                    sent.append(command.t[k])
                    log.append(number)
                    index.append(k)
        self.sent, self.log, self.index = np.array(sent), np.array(log, dtype=int), np.array(index, dtype=int)
        self.members = [np.array(m, dtype=int) for m in members]

    def problem(self, shift: np.ndarray) -> FitProblem:
        """The problem in which message k acts ``shift[k]`` [s] later than the fitted delay says."""
        commands = []
        for number, command in enumerate(self.windows.commands):
            own = self.log == number
            t = command.t.copy()
            t[self.index[own]] += shift[own]
            commands.append(CommandSeries(np.maximum.accumulate(t + 1e-9 * np.arange(len(t))), command.value))
        return self.question.problem(replace(self.windows, commands=tuple(commands)))

    def linearise(self, fit: Fit, shift: np.ndarray) -> _Linear:
        """Residuals of a fit as linear in the delays of all messages, states projected out."""
        problem = self.problem(shift)
        base, states = self._predict(problem, fit)
        weight = problem.weight
        residual = ((problem.windows.value - base) * weight).flatten(1).numpy()
        slopes = [(states[s] - base) * weight for s in range(len(states))]
        own = torch.stack(slopes, -1).flatten(1, 2).numpy()  # (W, NM, S)
        most = max((len(m) for m in self.members), default=0)
        response = np.zeros((len(self.members), residual.shape[1], most))
        for j in range(most):
            moved = shift.copy()
            # The j-th message of every window at once: windows do not see each other's.
            moved[[m[j] for m in self.members if len(m) > j]] += SHIFT
            there, _ = self._predict(self.problem(moved), fit, states=False)
            response[:, :, j] = ((there - base) * weight).flatten(1).numpy() / SHIFT
        members, information, pull = [], [], []
        for w, mine in enumerate(self.members):
            if len(mine) == 0:
                continue
            basis = np.linalg.qr(own[w])[0]
            g, r = response[w, :, : len(mine)], residual[w]
            g = g - basis @ (basis.T @ g)
            r = r - basis @ (basis.T @ r)
            a = g.T @ g
            members.append(mine)
            information.append(a)
            pull.append(g.T @ r + a @ shift[mine])
        return _Linear(members, information, pull)

    def refit(self, values: dict[str, float], shift: np.ndarray, fit: Fit) -> Fit:
        """Parameters under the messages' delays; the fitted delay stays, the messages carry the rest."""
        free = tuple(n for n in self.question.free if n != DELAY)
        trial = Trial("delays", free, self.question.prior, values, fit.state, fit.zero)
        return self.problem(shift).fit([trial], 12, TOLERANCE)[0]

    def _predict(
        self, problem: FitProblem, fit: Fit, states: bool = True
    ) -> tuple[torch.Tensor, torch.Tensor]:
        size = fit.state.shape[1] if states else 0
        theta = np.tile([[fit.values[n] for n in problem.names]], (1 + size, 1))
        lanes = fit.state[None].repeat(1 + size, 1, 1)
        for s in range(size):
            lanes[1 + s, :, s] += PARAMETER_STEP
        predicted = problem.predict(theta, lanes, fit.zero[None].repeat(1 + size, 1))
        return predicted[0], predicted[1:]


def _normal_law(linear: _Linear) -> tuple[float, float, float, float, float]:
    """Mean, spread, standard errors of mean and log spread, and evidence against a constant delay."""
    sd0 = 3e-3

    def cost(x: np.ndarray) -> float:
        return -linear.log_marginal(1e-3 * x[0], 1e-3 * math.exp(x[1]))

    found = minimize(
        cost,
        np.array([0.0, math.log(1e3 * sd0)]),
        method="L-BFGS-B",
        bounds=[(None, None), (math.log(1e3 * SMALLEST_SPREAD), None)],
    )
    mean, log_sd = found.x
    constant = minimize(lambda x: cost(np.array([x[0], math.log(1e3 * SMALLEST_SPREAD)])), np.zeros(1))
    step, hessian = 1e-3, np.zeros((2, 2))
    for i in range(2):
        for j in range(2):
            at = [found.x + step * (a * np.eye(2)[i] + b * np.eye(2)[j]) for a in (1, -1) for b in (1, -1)]
            hessian[i, j] = (cost(at[0]) - cost(at[1]) - cost(at[2]) + cost(at[3])) / (4 * step**2)
    errors = np.sqrt(np.diag(np.linalg.pinv(hessian)).clip(0.0))
    evidence = 2.0 * float(constant.fun - found.fun)
    return 1e-3 * mean, 1e-3 * math.exp(log_sd), 1e-3 * float(errors[0]), float(errors[1]), evidence


def _mixture_law(
    linear: _Linear, components: int, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Means, spreads, weights, and the messages' posterior, by stochastic-approximation EM."""
    mean, sd, *_ = _normal_law(linear)
    count = max(int(max(m.max() for m in linear.members)) + 1, 1)
    # Start from the quantiles of a draw under the single normal law.
    eps = linear.draw(np.full(count, mean), np.full(count, sd), generator)
    means = np.quantile(eps, (np.arange(components) + 0.5) / components)
    spreads = np.full(components, max(eps.std() / components, 2 * SMALLEST_SPREAD))
    weights = np.full(components, 1.0 / components)
    held = None
    total, square, kept = np.zeros(count), np.zeros(count), 0
    for sweep in range(SWEEPS):
        score = np.log(weights) - np.log(spreads) - 0.5 * ((eps[:, None] - means) / spreads) ** 2
        share = np.exp(score - score.max(1, keepdims=True))
        share /= share.sum(1, keepdims=True)
        label = (generator.random((count, 1)) > share.cumsum(1)[:, :-1]).sum(1)
        eps = linear.draw(means[label], spreads[label], generator)
        one = np.eye(components)[label]
        now = np.stack([one.sum(0), one.T @ eps, one.T @ eps**2])
        gain = 1.0 if sweep < WARM_UP else (sweep - WARM_UP + 1.0) ** -0.7
        held = now if held is None else held + gain * (now - held)
        size = held[0] + 1e-9
        weights = (size + 1.0) / (size + 1.0).sum()
        means = np.where(size > 0.5, held[1] / size, means)
        variance = held[2] / size - means**2
        # An inverse-gamma prior of weight one on the spread keeps a component from closing on one message.
        spreads = np.sqrt(np.maximum((size * variance + (0.1 * sd) ** 2) / (size + 1.0), SMALLEST_SPREAD**2))
        if sweep >= WARM_UP:
            total, square, kept = total + eps, square + eps**2, kept + 1
    centre = total / kept
    return means, spreads, weights, (centre, np.sqrt((square / kept - centre**2).clip(0.0)))
