"""The next observation from this one and the action: what a policy needs of the world to bridge a delay."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from deepkoco.koopman.latent_model import Array


class ForwardModelError(ValueError):
    """A forward model does not fit its policy, or its parts do not fit each other."""


@dataclass(frozen=True)
class ForwardModel:
    r"""$o_{k+1} = o_k + g(o_k, a_k)$ with a tanh network g, repeated for longer times.

    Of a part f of a step it takes the part f of the change. An action that changes within a step counts by its
    mean over this step, as in the delay wrapper.

    Attributes:
        layers: Weight (out, in) and bias (out,) of each layer of g.
        time_step: Seconds per step.
    """

    layers: tuple[tuple[Array, Array], ...]
    time_step: float

    @property
    def observation_size(self) -> int:
        """N."""
        return self.layers[-1][1].size

    @property
    def action_size(self) -> int:
        """M."""
        return self.layers[0][0].shape[1] - self.observation_size

    def change(self, observation: Array, action: Array) -> Array:
        """g: the change of the observation (..., N) over one step with the action (..., M) held."""
        return self._change(np.concatenate((observation, action), axis=-1))

    def predict(self, observation: Array, elapsed: float, times: Array, actions: Array) -> Array:
        """The observation at a later time; arguments and action as in `StateRoll.linearise_later`.

        Returns:
            Predicted observation (N,).
        """
        steps = max(math.ceil(elapsed - 1e-9), 0)
        means = step_means(steps, elapsed, times, actions)
        x = np.empty(self.layers[0][0].shape[1])
        size = self.observation_size
        x[:size] = observation
        for k in range(steps):
            x[size:] = means[k]
            part = min(1.0, elapsed - k)
            x[:size] += self._change(x) if part == 1.0 else part * self._change(x)
        return x[:size]

    def _change(self, x: Array) -> Array:
        for weight, bias in self.layers[:-1]:
            x = x @ weight.T
            x += bias
            np.tanh(x, x)
        weight, bias = self.layers[-1]
        return x @ weight.T + bias


def step_means(steps: int, elapsed: float, times: Array, actions: Array) -> Array:
    """Means over each step of an action that changes between them.

    Args:
        steps: Steps K that the time is divided into; the last one may be shorter.
        elapsed: The whole time, in steps.
        times: When the action changes (C,), increasing.
        actions: Before the first change, then after each (1 + C, M).

    Returns:
        (steps, M).
    """
    if not len(times):
        return np.broadcast_to(actions, (steps, actions.shape[1]))
    edges = np.minimum(np.arange(steps + 1.0), elapsed)
    begin = np.concatenate(([0.0], times))
    end = np.concatenate((times, [elapsed]))
    shares = np.minimum(end, edges[1:, None]) - np.maximum(begin, edges[:-1, None])
    return np.maximum(shares, 0.0) @ actions / np.diff(edges)[:, None]
