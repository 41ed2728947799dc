"""The next observation from this one and the action: what a policy needs of the world to bridge a delay."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

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
        x = np.concatenate((observation, action), axis=-1)
        for weight, bias in self.layers[:-1]:
            x = np.tanh(x @ weight.T + bias)
        weight, bias = self.layers[-1]
        return x @ weight.T + bias

    def predict(self, observation: Array, elapsed: float, times: Array, actions: Array) -> Array:
        """The observation at a later time; arguments and action as in `StateRoll.linearise_later`.

        Returns:
            Predicted observation (N,).
        """
        steps = max(math.ceil(elapsed - 1e-9), 0)
        seen, acted, bias = self._first_layer
        # What the actions add to the first layer is known beforehand for all steps. The rest goes through buffers:
        # half of the time of the same products in new memory.
        inputs = step_means(steps, elapsed, times, actions) @ acted + bias
        first = np.empty(bias.size)
        later = [(weight, bias, np.empty(bias.size)) for weight, bias in self.layers[1:]]
        x = np.array(observation, np.float64)
        for k, row in enumerate(inputs):
            values = np.dot(seen, x, out=first)
            values += row
            for weight, bias, buffer in later:
                np.tanh(values, values)
                values = np.dot(weight, values, out=buffer)
                values += bias
            if elapsed - k < 1.0:
                values *= elapsed - k
            x += values
        return x

    @cached_property
    def _first_layer(self) -> tuple[Array, Array, Array]:
        """Of the observation (out, N), of the action (M, out), and the bias (out,)."""
        weight, bias = self.layers[0]
        size = self.observation_size
        seen, acted = np.ascontiguousarray(weight[:, :size]), np.ascontiguousarray(weight[:, size:].T)
        return seen, acted, bias


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
    changes = times.tolist()
    if elapsed == steps and all(map(float.is_integer, changes)):
        held = np.diff([0, *map(int, changes), steps])  # whole steps: no action is divided
        return actions.repeat(held, axis=0)
    edges = np.minimum(np.arange(steps + 1.0), elapsed)
    begin = np.concatenate(([0.0], times))
    end = np.concatenate((times, [elapsed]))
    shares = np.minimum(end, edges[1:, None]) - np.maximum(begin, edges[:-1, None])
    return np.maximum(shares, 0.0) @ actions / np.diff(edges)[:, None]
