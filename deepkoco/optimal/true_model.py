"""An environment's own equations as a function of state and action, for controllers that may know them."""

from __future__ import annotations

import torch
from gymnasium.vector import VectorEnv, VectorRewardWrapper, VectorWrapper
from torch import Tensor

from deepkoco.engines.ode import World
from deepkoco.envs.delay_env import DelayGraphVectorEnv
from deepkoco.envs.settings import EnvironmentSettings
from deepkoco.graph.delay import make_delay


class TrueModelError(ValueError):
    """An environment is no function of state and action: delays, a lag, effects with a memory, random parameters."""


class TrueModel:
    """One step of the agent on an environment's own equations: x' = f(x, a), cost c(x, a).

    Actions are commands in their units. Noise of the sensors is left out: what is controlled is the true state.

    Args:
        settings: Of the environment.
        substeps: Steps of the integrator per step of the agent; None: as many as the environment's own.

    Attributes:
        low: Smallest actions (M,).
        high: Largest actions (M,).
        state_size: S.
        angles: How many entries, at the start of the state, are joint angles.
        time_step: Of the agent [s].

    Raises:
        TrueModelError: The environment has delays, a lag of its actuators or random parameters.
    """

    def __init__(self, settings: EnvironmentSettings, substeps: int | None = None) -> None:
        self.task = settings.find_task()
        self.scene = self.task.scene(settings.make_system())
        self._parameters = self.scene.default_parameters()
        timing = self.scene.timing(self._parameters)
        delays = [settings.actuation_delay, settings.sensing_delay]
        if any(float(make_delay(delay).mean) for delay in delays) or any(
            float(part.max()) for part in timing
        ):
            raise TrueModelError(
                "the environment has delays or a lag: the next state is no function of the last"
            )
        if self.scene.joint_memory(self._parameters).parts or any(
            width is not None for width in self.scene.output_play(self._parameters)
        ):
            raise TrueModelError("an effect remembers the way of its joint: the state does not say all")
        if settings.randomize:
            raise TrueModelError(f"the environment draws {', '.join(settings.randomize)} at random")
        own = settings.ticks_per_second / self.task.control_rate
        if own != round(own):
            raise TrueModelError(
                f"the physics' rate of {settings.ticks_per_second:g} Hz is no multiple of the agent's "
                f"{self.task.control_rate:g} Hz"
            )
        self.substeps = round(own) if substeps is None else substeps
        self.time_step = 1.0 / self.task.control_rate
        rate = self.task.control_rate * self.substeps
        self._world = World(
            self.scene, rate, settings.integrator, self.task.command_limits, self.task.speed_limit
        )
        low, high = zip(*self._world.limits, strict=True)
        self.low = torch.tensor(low, dtype=torch.float64)
        self.high = torch.tensor(high, dtype=torch.float64)
        self.state_size, self.angles = len(self.scene.state_names), self.scene.joints

    @classmethod
    def of(cls, envs: VectorEnv, substeps: int | None = None) -> TrueModel:
        """Model of the package's own environments, below wrappers that leave the cost as it is.

        Raises:
            TrueModelError: They are others, no function of state and action, or a wrapper replaces their cost.
        """
        inner, outer = envs.unwrapped, envs
        while isinstance(outer, VectorWrapper):
            if isinstance(outer, VectorRewardWrapper):
                raise TrueModelError(f"{type(outer).__name__} replaces the cost of the task")
            outer = outer.env
        if not isinstance(inner, DelayGraphVectorEnv):
            raise TrueModelError(f"{type(inner).__name__} does not tell its equations")
        return cls(inner.settings, substeps)

    def step(self, state: Tensor, action: Tensor) -> Tensor:
        """State (..., S) one step of the agent after a state (..., S) with an action (..., M) held over it."""
        command = self.scene.effort_of(torch.minimum(torch.maximum(action, self.low), self.high))
        effort = self.scene.actuate(command, self._parameters)
        for _ in range(self.substeps):
            state = self._world.advance_by(state, effort, self._world.period, self._parameters)
        return state

    def cost(self, state: Tensor, action: Tensor) -> Tensor:
        """Cost (...) of a state (..., S) and the action (..., M) given there."""
        return self.task.cost(self.scene, state, action)


def start_states(envs: VectorEnv, seed: int) -> Tensor:
    """States (B, S) that environments start from with a seed; they are reset.

    Raises:
        TrueModelError: They are not the package's own.
    """
    inner = envs.unwrapped
    if not isinstance(inner, DelayGraphVectorEnv):
        raise TrueModelError(f"{type(inner).__name__} does not tell its state")
    envs.reset(seed=seed)
    return inner.state.nodes["agent"]["truth"].cpu().clone()
