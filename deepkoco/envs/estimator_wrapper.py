"""The state estimator around any Gymnasium environment: its agent sees the estimate in the place of the measurement."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from torch import Tensor

from deepkoco.envs.action_range import command_range
from deepkoco.envs.delay_arguments import step_rate
from deepkoco.envs.estimated import filter_settings
from deepkoco.envs.seeds import Seeds
from deepkoco.envs.settings import ESTIMATORS, SettingsError
from deepkoco.envs.tasks import Task
from deepkoco.fit.state.estimator import (
    LONGEST_STEP,
    DelayedEstimator,
    Memory,
    system_derivative,
    system_measurement,
)
from deepkoco.fit.state.lags import LagStates, mean_further_delay
from deepkoco.fit.state.unscented import Belief
from deepkoco.systems import System, any_system

MOST_COMMANDS = 64  # kept at least; at 50 Hz they reach back more than a second
REACH = 4.0  # times the expected delays, over which commands are kept at least
TIMES = ("time", "observation_age")


class Estimates:
    """Estimates of B environments, step by step: by the ``time`` in ``info``, or else by the number of steps.

    Args:
        count: B.
        env: Says ``system``, ``task`` and ``action_scale`` where they are not given.
        rate: Steps per second [Hz].
        estimator: ``filtered`` or ``predicted``.
        actuation_delay: Expected time from sending until a command acts [s]; None: that of the model, and what
            ``env`` expects besides.
        sensing_delay: Age of an observation [s] where ``info`` has no ``observation_age``; None: likewise.
        process_noise: As for `EnvironmentSettings`.
        model: What `load_system` takes, for a model of other parameters; None: the system of ``env``.

    Raises:
        SettingsError: The environment has no task, or the estimator is unknown.
        FilterError: The filter cannot be made for this system.
    """

    def __init__(
        self,
        count: int,
        env: Any,
        rate: float,
        estimator: str,
        actuation_delay: float | None,
        sensing_delay: float | None,
        process_noise: float,
        model: Any,
    ) -> None:
        if estimator not in ESTIMATORS[1:]:
            raise SettingsError(f'estimator "{estimator}" is none of {", ".join(ESTIMATORS[1:])}')
        task, system = _attribute(env, "task"), _attribute(env, "system")
        if not isinstance(task, Task) or not isinstance(system, System):
            raise SettingsError(
                "the environment has no task of deepkoco, so an observation does not say what was measured"
            )
        self.task, self.count, self.period = task, count, 1.0 / rate
        self.model = system if model is None else task.scene(any_system(model))
        self.predicts = estimator == "predicted"
        expected = getattr(env, "expected_delays", None)
        own = float(self.model.timing(self.model.default_parameters()).actuation_delay)
        outside = float(_or(None, getattr(expected, "actuation", None)))
        self.actuation_delay = float(_or(actuation_delay, outside + own))
        self.ahead = self.actuation_delay + mean_further_delay(self.model)
        sensing = None if expected is None else max(expected.sensing.values(), default=0.0)
        self.sensing_delay = float(_or(sensing_delay, sensing))
        self.scale = torch.as_tensor(np.array(_or(_attribute(env, "action_scale"), 1.0)), dtype=torch.float64)
        self.centre = torch.as_tensor(
            np.array(_or(_attribute(env, "action_centre"), 0.0)), dtype=torch.float64
        )
        self.low, self.high = (
            torch.from_numpy(end) for end in command_range(task.command_limits, self.model)
        )
        parameters = self.model.default_parameters()
        self.lags = LagStates(self.model)
        further = self.model.further_delays(parameters)
        self.width = len(task.observation_bounds)
        own = filter_settings(self.model, task, process_noise)
        self._start = torch.diag(torch.tensor(own.start_sd, dtype=torch.float64))
        self._filter = DelayedEstimator(
            system_derivative(self.model, parameters),
            system_measurement(self.model),
            torch.diag(torch.tensor(own.noise_density, dtype=torch.float64)),
            torch.tensor(own.noise_sd, dtype=torch.float64),
            kept=2,  # observations come in order
            angle=torch.tensor([c.angle for c in self.model.measurements]),
            # A step much longer than a time constant would not be stable.
            longest_step=min(LONGEST_STEP, self.lags.shortest),
            further=None if further is None else torch.stack(further).to(torch.float64),
        )
        self._idle = task.idle(self.model)
        delays = self.ahead + self.sensing_delay
        self._commands = max(MOST_COMMANDS, math.ceil(REACH * delays * rate))
        self._memory: Memory | None = None
        self._time = torch.zeros(count, dtype=torch.float64)

    def restart(
        self, observation: np.ndarray, info: Mapping[str, Any], mask: np.ndarray | None = None
    ) -> None:
        """Begin episodes: of all, or of those in ``mask`` (B,), with what they show (B, N) now."""
        self._tell_time(info)
        age = self._age(info)
        size = len(self._start)
        idle = self._idle.expand(self.count, -1)
        mean = torch.zeros(self.count, size, dtype=torch.float64)
        if self.lags.commands:
            held = self.model.actuate(self.model.effort_of(idle), self.model.default_parameters())
            mean[:, self.lags.states :] = self.lags.efforts(held)
        belief = Belief(mean, self._start.expand(self.count, size, size))
        fresh = self._filter.start(belief, self._time - age, idle, self._commands)
        fresh = self._filter.receive(fresh, self._time, self._measured(observation), age)
        if mask is not None and self._memory is not None:
            fresh = fresh.where(torch.from_numpy(np.asarray(mask, bool)), self._memory)
        self._memory = fresh

    def send(self, actions: np.ndarray) -> None:
        """Take note of the actions (B, M) of this step."""
        assert self._memory is not None
        given = torch.as_tensor(np.asarray(actions), dtype=torch.float64).reshape(self.count, -1)
        command = torch.minimum(torch.maximum(given * self.scale + self.centre, self.low), self.high)
        self._memory = self._filter.send(self._memory, self._time, command, self.actuation_delay)
        self._time = self._time + self.period

    def receive(self, observation: np.ndarray, info: Mapping[str, Any]) -> None:
        """Take in what is seen (B, N) at the end of the step."""
        assert self._memory is not None
        self._tell_time(info)
        age = self._age(info)
        _, last = self._memory.newest()
        # A sample that is seen again has told all it can.
        time = torch.where(self._time - age > last + 1e-9, self._time, torch.nan)
        self._memory = self._filter.receive(self._memory, time, self._measured(observation), age)

    def shown(self, observation: np.ndarray) -> np.ndarray:
        """Observations (B, N) with the estimate in the place of the newest measurement."""
        assert self._memory is not None
        if self.predicts:
            belief = self._filter.estimate(self._memory, self._time, self.ahead)
        else:
            belief, _ = self._memory.newest()
        seen = self.task.observation(
            self.model, self.model.ideal_measurement(self.lags.plain(belief.mean))
        ).numpy()
        result = np.array(observation)
        result[..., : self.width] = seen.astype(result.dtype)
        return result

    def _measured(self, observation: np.ndarray) -> Tensor:
        shown = np.asarray(observation, np.float64)[:, : self.width]
        return torch.tensor(np.array([self.task.measurement(self.model, row) for row in shown]))

    def _tell_time(self, info: Mapping[str, Any]) -> None:
        """Take the clock of the environment, which may be late for a step, in the place of a count of steps."""
        if "time" in info:
            own = np.broadcast_to(np.asarray(info["time"], np.float64), self.count)
            self._time = torch.tensor(own.copy())

    def _age(self, info: Mapping[str, Any]) -> Tensor:
        age = info.get("observation_age", self.sensing_delay)
        if isinstance(age, Mapping):  # by term: the oldest says when all of it was so
            age = np.max([np.broadcast_to(a, self.count) for a in age.values()], 0)
        return torch.tensor(np.broadcast_to(np.asarray(age, np.float64), self.count).copy())


class EstimatorWrapper(gymnasium.Wrapper, RecordConstructorArgs):
    """Shows the agent an estimate of the state in the place of the newest measurement.

    An unscented filter takes in each observation at the time at which it was measured, which ``observation_age`` in
    ``info`` says, and predicts with the actions that were sent. `DelayWrapper` and `UnitEnv` tell the age. Where
    ``info`` has the ``time`` of a step, as in real time, that is taken, else one step after the other. What is seen
    behind the task's own entries, such as past actions, stays.

    Args:
        env: An environment of a task of this package, or a wrapper around one.
        estimator: ``predicted``: the state at which the next action will act; ``filtered``: that of the newest
            measurement.
        actuation_delay: Expected time from sending until an action acts [s]; None: that of the
            model, and what a `DelayWrapper` expects besides.
        sensing_delay: Age of an observation [s] where ``info`` does not say it; None: likewise.
        process_noise: Standard deviation of the white acceleration of each joint, times the square root of a second.
        model: What `deepkoco.load_system` takes, for a model of other parameters; None: the system of ``env``.
        control_rate: Steps per second [Hz]; None takes 1/dt or the ``render_fps`` of the environment.

    Raises:
        SettingsError: The environment has no task, or the estimator is unknown.
        DelayWrapperError: The rate is not known.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        estimator: str = "predicted",
        *,
        actuation_delay: float | None = None,
        sensing_delay: float | None = None,
        process_noise: float = 1.0,
        model: Any = None,
        control_rate: float | None = None,
    ) -> None:
        RecordConstructorArgs.__init__(
            self, estimator=estimator, actuation_delay=actuation_delay, sensing_delay=sensing_delay,
            process_noise=process_noise, model=model, control_rate=control_rate,
        )  # fmt: skip
        gymnasium.Wrapper.__init__(self, env)
        self._estimates = Estimates(
            1, env, float(step_rate(env, control_rate)), estimator, actuation_delay, sensing_delay,
            process_noise, model,
        )  # fmt: skip

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Reset the environment; the first estimate is made of its first observation."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._estimates.restart(observation[None], info)
        return self._estimates.shown(observation[None])[0], info

    def step(self, action: Any):
        """Send an action; what is seen is the estimate after it."""
        self._estimates.send(np.asarray(action)[None])
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._estimates.receive(observation[None], info)
        return self._estimates.shown(observation[None])[0], reward, terminated, truncated, info


class VectorEstimatorWrapper(VectorWrapper, RecordConstructorArgs):
    """:class:`EstimatorWrapper` for a vector environment: one filter for all of its environments.

    Args:
        env, estimator, **options: As there.

    Raises:
        SettingsError: The environment has no task, or the estimator is unknown.
        DelayWrapperError: The rate is not known.
    """

    def __init__(
        self,
        env: VectorEnv,
        estimator: str = "predicted",
        *,
        actuation_delay: float | None = None,
        sensing_delay: float | None = None,
        process_noise: float = 1.0,
        model: Any = None,
        control_rate: float | None = None,
    ) -> None:
        RecordConstructorArgs.__init__(
            self, estimator=estimator, actuation_delay=actuation_delay, sensing_delay=sensing_delay,
            process_noise=process_noise, model=model, control_rate=control_rate,
        )  # fmt: skip
        VectorWrapper.__init__(self, env)
        self._estimates = Estimates(
            env.num_envs, env, float(step_rate(env, control_rate)), estimator, actuation_delay, sensing_delay,
            process_noise, model,
        )  # fmt: skip
        self._mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        self._ended = np.zeros(env.num_envs, bool)

    def reset(self, *, seed: Seeds = None, options: dict[str, Any] | None = None):
        """Reset the environments, or those in ``options["reset_mask"]``."""
        mask = None if options is None else options.get("reset_mask")  # Gymnasium takes it out of options
        observation, info = self.env.reset(seed=seed, options=options)  # pyright: ignore[reportArgumentType]
        self._estimates.restart(observation, info, mask)
        self._ended = self._ended & (False if mask is None else ~np.asarray(mask, bool))
        return self._estimates.shown(observation), info

    def step(self, actions: Any):
        """Send the actions (B, ...); what is seen are the estimates after it."""
        estimates = self._estimates
        estimates.send(actions)
        observation, reward, terminated, truncated, info = self.env.step(actions)
        ended = np.logical_or(terminated, truncated)
        starting = np.zeros(self.num_envs, bool)
        if self._mode == AutoresetMode.SAME_STEP and ended.any():
            last = np.array(observation)
            for place in np.flatnonzero(ended):
                last[place] = info["final_obs"][place]
            estimates.receive(last, _of_the_ended(info, ended))
            final = np.empty(self.num_envs, dtype=object)
            for place, row in enumerate(estimates.shown(last)):
                final[place] = row if ended[place] else None
            info, starting = {**info, "final_obs": final}, ended
        else:
            estimates.receive(observation, info)
            if self._mode == AutoresetMode.NEXT_STEP:
                starting = self._ended  # for these the step was a reset
        if starting.any():
            estimates.restart(observation, info, starting)
        self._ended = ended
        return estimates.shown(observation), reward, terminated, truncated, info


def _of_the_ended(info: Mapping[str, Any], ended: np.ndarray) -> dict[str, Any]:
    """What tells times, of the last step of environments that have ended and of this step of all others.

    Gymnasium gives zeros in ``final_info`` for environments that go on.
    """
    final = info.get("final_info", {})
    return {**info, **{n: _where(ended, final[n], info.get(n, final[n])) for n in TIMES if n in final}}


def _where(ended: np.ndarray, last: Any, now: Any) -> Any:
    if isinstance(last, Mapping):
        return {n: _where(ended, value, now.get(n, value)) for n, value in last.items()}
    return np.where(ended, last, now)


def _attribute(env: Any, name: str) -> Any:
    """An attribute of the environment inside; of a batch of single ones, that of the first."""
    inside = env.unwrapped
    if hasattr(inside, name):
        return getattr(inside, name)
    if isinstance(inside, gymnasium.vector.SyncVectorEnv):
        return getattr(inside.envs[0].unwrapped, name, None)
    batch = getattr(inside, "batch", None)
    return getattr(batch, name, None)


def _or(given: Any, otherwise: Any) -> Any:
    """What is given; else what is known; else 0."""
    return next((value for value in (given, otherwise) if value is not None), 0.0)
