"""A trained controller among delays that it was not trained with."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deepkoco.agent.policy import ObservationError
from deepkoco.agent.sent_commands import SentCommands
from deepkoco.koopman.forward_model import ForwardModel, ForwardModelError
from deepkoco.koopman.latent_model import Array, LatentModel
from deepkoco.koopman.roll import LatentRoll, ObservationRoll, StateRoll
from deepkoco.planning.config import PlannerConfig
from deepkoco.planning.methods import make_planner
from deepkoco.planning.statistics import PlannerStatistics

WHOLE = 1e-9
"""Nearer to a whole number of steps than this is whole."""


class DelayError(ValueError):
    """A delay is no number of seconds, or the model cannot be rolled."""


class DelayedPolicy:
    r"""`KoopmanPolicy` for observations that are old and commands that act late, without retraining.

    At time t, an observation of age $\tau_o$ is there and the command decided now will be sent at t + T and act at
    t + T + $\tau_a$, where T is the step. The policy rolls the observation through the commands that act in
    between, to t + $\tau_a$, where the planner stands one step before its first action acts, as in training.
    Without delays it is `KoopmanPolicy` bit for bit.

    Delays are seconds, of any size and different at every call. `sensing_delay` and `actuation_delay` are expected
    ones (means of their laws), for where a call does not tell; once `measure` has told of commands that have arrived,
    their mean delay is the expected one. Of observations with known age the newest counts, in whatever order they
    come.

    Where delays of commands are random, ask for calmer commands by a larger `PlannerConfig.increment_weight`: what
    acts is then less far from what was expected to act.
    """

    def __init__(
        self,
        model: LatentModel,
        planner: PlannerConfig,
        action_low: Array,
        action_high: Array,
        forward: ForwardModel | None = None,
        sensing_delay: float = 0.0,
        actuation_delay: float = 0.0,
    ) -> None:
        """Set up the controller.

        Args:
            model: The latent model, without a history of observations.
            planner: Settings of the planner.
            action_low: a_min (M,).
            action_high: a_max (M,).
            forward: Predicts observations, which are then encoded; None rolls the latent, exact for linear models.
            sensing_delay: Expected age of an observation [s].
            actuation_delay: Expected time from sending a command until it acts [s].

        Raises:
            DelayError: A delay is negative or not finite, or the model takes a history of observations.
            ForwardModelError: The forward model has other sizes or another step than the model.
        """
        self._sensing = _seconds(sensing_delay, "sensing_delay")
        self._actuation = _seconds(actuation_delay, "actuation_delay")
        if model.make_history() is not None:
            raise DelayError(
                "this model takes the observations of several steps, which delays put out of step; "
                "use one that takes the present observation"
            )
        self.model = model
        self._planner_config, self._forward = planner, forward
        self._roll = _make_roll(model, forward)
        self._low, self._high = np.asarray(action_low, np.float64), np.asarray(action_high, np.float64)
        self._planner = make_planner(model, planner, self._low, self._high)
        self._sent = SentCommands()
        self.reset()

    @property
    def statistics(self) -> PlannerStatistics:
        """Plans made and failed so far."""
        return self._planner.statistics

    def another(self) -> DelayedPolicy:
        """A policy of the same settings for another environment."""
        delays = self._sensing, self._actuation
        return DelayedPolicy(self.model, self._planner_config, self._low, self._high, self._forward, *delays)

    def reset(self) -> None:
        """Start a new episode: action zero acts, nothing is sent or seen."""
        self._next = np.clip(np.zeros_like(self._low), self._low, self._high)
        self._planner.reset()
        self._sent.start(self._next)
        self._begin: float | None = None
        self._newest = -math.inf  # time of the observation that counts [steps]
        self._observation = np.zeros(0)
        self._now = 0.0

    def measure(self, delays: Iterable[float]) -> None:
        """Take in what is known, since the last `act`, of the delays of the commands sent.

        Args:
            delays: Seconds from sending to acting of the last commands, newest first; infinite: has not arrived yet.
        """
        known = [self._steps(delay) if math.isfinite(delay) else math.inf for delay in delays]
        self._sent.measure(known, self._now + 1.0)

    def act(
        self,
        observation: ArrayLike,
        observation_age: float | None = None,
        actuation_delay: float | None = None,
        now: float | None = None,
    ) -> NDArray[np.float32]:
        """Control one step.

        Args:
            observation: The observation (N,) that is there.
            observation_age: Seconds since it was measured; None takes the expected age.
            actuation_delay: Seconds from sending to acting of this and the next command; None takes the expected
                delay.
            now: Time on any clock [s]; None: one step after the last call.

        Returns:
            The command (M,) to send now. It was decided at the last call; the next one is decided now.

        Raises:
            ObservationError: The observation does not have N entries.
            DelayError: A delay is negative or not finite, or the clock goes back.
        """
        age = self._sensing if observation_age is None else _seconds(observation_age, "observation_age")
        time = self._time(now)
        command, acts = self._next, time + self._delay_of_commands(actuation_delay)
        self._sent.send(command, time, acts)
        self._see(observation, time - self._steps(age), stamped=observation_age is not None)
        target = max(acts, self._newest)
        times, actions = self._sent.between(self._newest, target)
        rows, factor = self._roll.linearise_later(
            self._observation, target - self._newest, times - self._newest, actions
        )
        self._next = actions[-1] + self._planner.plan(rows, factor, actions[-1])
        return command.astype(np.float32)

    def _time(self, now: float | None) -> float:
        """The time of this call in steps."""
        following = 0.0 if self._begin is None else self._now + 1.0
        time = following if now is None else self._steps(now)
        if self._begin is None:
            self._begin = time
        elif not time >= self._now:
            raise DelayError(
                f"now = {now} s is before the last call, at {self._now * self.model.time_step} s"
            )
        self._now = time
        return time

    def _delay_of_commands(self, given: float | None) -> float:
        """Known or expected delay of the next commands, in steps."""
        if given is not None:
            return self._steps(_seconds(given, "actuation_delay"))
        measured = self._sent.mean_delay
        return self._steps(self._actuation) if measured is None else measured

    def _steps(self, seconds: float) -> float:
        """Seconds in steps; 0.15 s / 0.05 s is not 3 in floating point, and which command acts hangs on it."""
        steps = seconds / self.model.time_step
        whole = round(steps)
        return float(whole) if abs(steps - whole) < WHOLE else steps

    def _see(self, observation: ArrayLike, measured: float, stamped: bool) -> None:
        """Keep an observation unless a newer one is there."""
        entries = np.asarray(observation, dtype=np.float64)
        if entries.shape != (self.model.observation_size,):
            raise ObservationError(
                f"observation has shape {entries.shape}; this model takes ({self.model.observation_size},)"
            )
        if not stamped and self._begin is not None:
            measured = max(measured, self._begin)  # an expected age may reach back before the episode
        if not stamped or measured >= self._newest:
            self._observation, self._newest = entries, measured


def _make_roll(model: LatentModel, forward: ForwardModel | None) -> StateRoll:
    if forward is None:
        return LatentRoll(model)
    sizes = (forward.observation_size, forward.action_size)
    if sizes != (model.observation_size, model.action_size):
        raise ForwardModelError(
            f"the forward model predicts {sizes[0]} entries with {sizes[1]} actions; the policy takes "
            f"{model.observation_size} and {model.action_size}"
        )
    if not math.isclose(forward.time_step, model.time_step):
        raise ForwardModelError(
            f"the forward model steps by {forward.time_step:g} s and the policy by {model.time_step:g} s"
        )
    return ObservationRoll(model, forward)


def _seconds(delay: float, name: str) -> float:
    if not 0.0 <= delay < math.inf:
        raise DelayError(f"{name} = {delay}; give a number of seconds, 0 or more")
    return float(delay)
