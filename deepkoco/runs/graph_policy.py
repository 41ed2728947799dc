"""A trained policy as what decides in a graph, with the time stamps of its messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from deepkoco.agent.delayed_policy import DelayedPolicy
from deepkoco.graph import Input

Observe = Callable[[NDArray[np.float64]], ArrayLike]
"""From what a sensor sends to the observation (N,) that the policy takes."""


class GraphPolicy:
    """Gives the action of the supervisor at each of its steps, in simulated and in wall-clock time.

    The age of an observation is the time between the end of the sensor's step and the start of this one, both as
    stamped by the runtime. With ``window`` above 1 and ``fifo=False`` on the connection the newest message counts,
    not the last that came. One graph has one environment; it takes a policy for each.
    """

    def __init__(self, policy: DelayedPolicy, sensor: str = "sensor", observe: Observe | None = None) -> None:
        """Let a policy decide.

        Args:
            policy: Told the ages; its `actuation_delay` is the expected time from its step until its action acts.
            sensor: Name of the input with the measurements.
            observe: Makes the observation of a message; None takes it as it is.
        """
        self._policy, self._sensor = policy, sensor
        self._observe: Observe = observe or (lambda measured: measured)
        self.reset()

    def reset(self) -> None:
        """Start a new episode."""
        self._policy.reset()
        self._begin: float | None = None

    def __call__(self, inputs: Mapping[str, Input]) -> Tensor:
        """Decide.

        Args:
            inputs: Of the supervisor's step, of one environment.

        Returns:
            The action (1, M) to send now.
        """
        seen = inputs[self._sensor]
        newest = int(seen.seq[0].argmax())
        now = float(seen.t_start[0])
        if self._begin is None:
            self._begin = now
        # What the sensor showed before its first message has no stamp; it is as old as the episode.
        sent = float(seen.t_sent[0, newest]) if int(seen.seq[0, newest]) >= 0 else self._begin
        observation = self._observe(seen.data[0, newest].detach().cpu().numpy())
        action = self._policy.act(observation, max(0.0, now - sent), now=now)
        return torch.from_numpy(action.astype(np.float64))[None]
