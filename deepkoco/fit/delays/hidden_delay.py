"""Estimate the distribution of unmeasured delays of the commands from the motion of the joint."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from deepkoco.fit.data.windows import CommandSeries
from deepkoco.fit.delays.linear_delays import SMALLEST_SPREAD, LinearDelays, mixture_law
from deepkoco.fit.delays.normal_law import normal_law
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Fit, Trial
from deepkoco.fit.identification import NORMAL_95, Identification
from deepkoco.fit.request import FitError, command_delays
from deepkoco.fit.solve.methods import TOLERANCE
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.fit.tangent import PARAMETER_STEP
from deepkoco.fit.threads import one_thread
from deepkoco.graph.delay import Delay, Deterministic, Gaussian, Mixture

SHIFT = 1e-3  # finite difference of one message's delay [s]
ROUNDS, MIXTURE_ROUNDS = 8, 4  # largest number of linearisations
SETTLED = 0.1  # the delays have converged if their root mean square change is smaller [standard deviations]
LARGEST_STEP = 0.01  # largest change of a delay from one linearisation to the next [s]


@dataclass(frozen=True)
class HiddenDelays:
    """Distribution of the delays of command messages.

    Attributes:
        law: The distribution as a law of the delay graph.
        means: (C,) means of its components [s], ascending.
        spreads: (C,) their standard deviations [s].
        weights: (C,) their shares.
        mean_interval: 95 % interval of the overall mean [s].
        spread_interval: 95 % interval of the standard deviation [s]; NaN for more than one component.
        evidence: Twice the difference of the log marginal likelihoods of one normal law and of a constant delay. Above
            about 10, the delay varies beyond doubt.
        sent: (K,) times at which the messages that changed the command were sent [s], log after log.
        log: (K,) index of the log of each message.
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

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, without the single messages."""
        known = math.isfinite(self.spread_interval[0])
        return {
            "law": self.law.to_dict(),
            "mean_s": self.mean,
            "mean_interval_s": list(self.mean_interval),
            "spread_s": self.spread,
            "spread_interval_s": list(self.spread_interval) if known else None,
            "evidence": self.evidence,
            "messages": len(self.sent),
        }


def hidden_delays(found: Identification, components: int = 1, seed: int = 0) -> HiddenDelays:
    r"""Estimate the distribution of the commands' delays by marginal likelihood.

    A command that acts eps later than usual gives the joint a known impulse, to first order. The residuals r of a
    window are therefore linear in the delays of its messages: r = G eps + J x + noise. A projection P removes the
    initial states x. Then A = G' P G and h = G' P r contain all information about the delays. For a normal law of
    eps, the marginal likelihood has a closed form, which is maximised. A mixture adds one unknown component per
    message. It is fitted by stochastic-approximation EM with Gibbs draws of the components; the delays are integrated
    out. After each estimate, the parameters are fitted again at the posterior mean delays. The residuals are then
    linearised there, until the delays converge.

    Args:
        found: A fit, best with the delay of the commands among its parameters. Messages are assumed to keep their
            order.
        components: Number of normal components of the law.
        seed: Seed of the Gibbs draws.

    Raises:
        FitError: Fewer than 10 commands per component change inside the windows, or they do not move the joint. Or
            the simulation diverges when a command acts later.

    Source: Delyon, Lavielle, Moulines, Convergence of a stochastic approximation version of the EM algorithm (1999).
    """
    if components < 1:
        raise FitError(f"components: {components}; a law needs at least one component")
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
            single = normal_law(linear)
            if not math.isfinite(single.mean_sd):
                raise FitError(
                    "the commands that change do not move the joint, so the log has no information about their delay"
                )
            size = np.ones(len(shift))
            posterior = linear.posterior(single.mean * size, single.spread * size)
            shift, settled = messages.towards(shift, *posterior)
            fit = messages.refit(values, shift, fit)
            values = fit.values
            if settled:
                break
        law = None
        for _ in range(MIXTURE_ROUNDS if components > 1 else 0):
            linear = messages.linearise(fit, shift)
            law = mixture_law(linear, posterior[0] if law is None else law, components, generator)
            posterior = law.centre, law.sd
            shift, settled = messages.towards(shift, *posterior)
            fit = messages.refit(values, shift, fit)
            values = fit.values
            if settled:
                break
    base = messages.base
    if law is None:
        means, spreads, weights = np.array([single.mean]), np.array([single.spread]), np.ones(1)
    else:
        means, spreads, weights = law.means, law.spreads, law.weights
    order = np.argsort(means)
    means, spreads, weights = base + means[order], spreads[order], weights[order]
    reach = NORMAL_95 * single.mean_sd
    overall = float(weights @ means)
    return HiddenDelays(
        _law(means, spreads, weights),
        means,
        spreads,
        weights,
        (overall - reach, overall + reach),
        single.spread_interval if components == 1 else (math.nan, math.nan),
        single.evidence,
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


class _Messages:
    """The command messages that act inside the windows of a fit."""

    def __init__(self, found: Identification) -> None:
        self.request = found.request
        self.windows = found.request.windows
        self.delays = command_delays(found.request.system.base)
        own = [found.fit.values[n] for n in self.delays if n in found.fit.values]
        # A message contains the commands of all joints, so it adds one number to their fitted delays.
        self.base = base = float(np.mean(own)) if own else 0.0
        sent, log, index, members = [], [], [], [[] for _ in range(len(self.windows))]
        for number, command in enumerate(self.windows.commands):
            value = command.value.reshape(len(command.t), -1)
            changed = 1 + np.flatnonzero((np.diff(value, axis=0) != 0).any(1))
            for w in np.flatnonzero(self.windows.log == number):
                begin = self.windows.t0[w]
                acts = command.t[changed] + base
                # Messages that act outside a window give it no information about their delays.
                inside = changed[(acts > begin) & (acts < begin + self.windows.length)]
                for k in inside:
                    members[w].append(len(sent))
                    sent.append(command.t[k])
                    log.append(number)
                    index.append(k)
        self.sent, self.log, self.index = np.array(sent), np.array(log, dtype=int), np.array(index, dtype=int)
        self.members = [np.array(m, dtype=int) for m in members]

    def problem(self, shift: np.ndarray) -> FitProblem:
        """The fit problem in which message k acts ``shift[k]`` [s] later than the fitted delay."""
        commands = []
        for number, command in enumerate(self.windows.commands):
            own = self.log == number
            t = command.t.copy()
            t[self.index[own]] += shift[own]
            commands.append(CommandSeries(np.maximum.accumulate(t + 1e-9 * np.arange(len(t))), command.value))
        return self.request.problem(replace(self.windows, commands=tuple(commands)))

    def towards(self, shift: np.ndarray, wanted: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, bool]:
        """Move ``shift`` towards ``wanted`` by at most `LARGEST_STEP`, so that no delay becomes negative.

        Returns:
            The new shift, and whether it has converged (`SETTLED`).
        """
        step = np.clip(wanted - shift, -LARGEST_STEP, LARGEST_STEP)
        moved = np.maximum(shift + step, -self.base)
        return moved, float(np.sqrt(np.mean(((moved - shift) / sd) ** 2))) < SETTLED

    def linearise(self, fit: Fit, shift: np.ndarray) -> LinearDelays:
        """Linearise the residuals of a fit in the delays of all messages, initial states projected out."""
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
            # One simulation shifts the j-th message of every window: a shift affects its own window only.
            moved[[m[j] for m in self.members if len(m) > j]] += SHIFT
            there, _ = self._predict(self.problem(moved), fit, states=False)
            response[:, :, j] = ((there - base) * weight).flatten(1).numpy() / SHIFT
        if not all(np.isfinite(x).all() for x in (residual, own, response)):
            raise FitError(
                "the simulation diverges when a command acts a little later; fit the parameters first, or give a "
                "shorter window"
            )
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
        return LinearDelays(members, information, pull)

    def refit(self, values: dict[str, float], shift: np.ndarray, fit: Fit) -> Fit:
        """Fit the parameters again at given delays of the messages, without the delay parameters themselves."""
        free = tuple(n for n in self.request.free if n not in self.delays)
        trial = Trial("delays", free, self.request.prior, values, fit.state, fit.nuisance)
        try:
            return self.problem(shift).fit_one(trial, 12, TOLERANCE)
        except DivergedError as error:
            raise FitError(f"with the delays found so far, {error}; give a shorter window") from error

    def _predict(
        self, problem: FitProblem, fit: Fit, states: bool = True
    ) -> tuple[torch.Tensor, torch.Tensor]:
        size = fit.state.shape[1] if states else 0
        theta = np.tile([[fit.values[n] for n in problem.names]], (1 + size, 1))
        lanes = fit.state[None].repeat(1 + size, 1, 1)
        for s in range(size):
            lanes[1 + s, :, s] += PARAMETER_STEP
        predicted = problem.predict(theta, lanes, fit.nuisance[None].repeat(1 + size, 1))
        return predicted[0], predicted[1:]
