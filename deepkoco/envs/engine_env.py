"""A task on an object as a Gymnasium environment, on whatever engine: equations, MuJoCo or a unit."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces

from deepkoco.engines import Engine, MujocoEngine, OdeEngine, find_engine, find_object, make_graph
from deepkoco.envs.actions import check_finite_action
from deepkoco.envs.nodes import TaskAgent
from deepkoco.envs.settings import ACTION_UNITS, SettingsError
from deepkoco.envs.tasks import SWING_UPS
from deepkoco.graph import Node, draw_timing
from deepkoco.graph.live import SimulatedRuntime, WallClockRuntime
from deepkoco.systems import JointSystem


class EngineEnv(gymnasium.Env):
    """One environment whose object runs on an engine; the agent's side is the same on all of them.

    A simulating engine and a unit in virtual time run event by event; a unit in its own process runs by the clock
    on the wall, with one step of the agent per control period. The reward is minus the task's cost of the true
    state, on a unit of the last measurement. The environment never cuts an episode; close it to stop a unit.

    Args:
        object: Name of the object.
        engine: ``ode``, ``mujoco``, ``unit``, or an engine with settings of its own. By its name, a simulating
            engine takes the limits of the task.
        actuation_delay, sensing_delay: Seconds, a delay law or its description; a unit's own come on top, and
            in real time these are only expectations.
        action_history: How many past actions are appended to the observation, newest first.
        action_units: ``normalized``: actions in [-1, 1]; ``physical``: in the command's unit.
        render_mode: None or ``rgb_array``.
        render_size: Side of the picture [pixels].
        longest_episode: Steps for which delays are drawn; going on beyond them is an error.
        action_nodes: Nodes between the agent and the actuator, as for `make_graph`.

    Raises:
        ValueError: A setting is wrong; the message says which and what it may be.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 - Gymnasium declares it so

    def __init__(
        self,
        object: str = "rod_pendulum",
        engine: str | Engine = "ode",
        actuation_delay: Any = 0.0,
        sensing_delay: Any = 0.0,
        action_history: int = 0,
        action_units: str = "normalized",
        render_mode: str | None = None,
        render_size: int = 256,
        longest_episode: int = 1000,
        action_nodes: Iterable[Node] = (),
    ) -> None:
        if action_units not in ACTION_UNITS:
            raise SettingsError(f'action_units "{action_units}" is none of {", ".join(ACTION_UNITS)}')
        if action_history < 0:
            raise SettingsError(f"action_history = {action_history}; give 0 or more")
        system = find_object(object).dynamics
        if object not in SWING_UPS or not isinstance(system, JointSystem):
            raise SettingsError(
                f'object "{object}" has no task; those with one are {", ".join(SWING_UPS)}. For another object make a '
                "GraphVectorEnv of make_graph(...)"
            )
        self.system, self.task = system, SWING_UPS[object]
        self.engine = self._with_limits(engine)
        self.render_mode, self.render_size, self.longest_episode = render_mode, render_size, longest_episode
        self.metadata = {**self.metadata, "render_fps": round(self.task.control_rate)}
        limit = self.task.command_limit
        self.action_scale = limit if action_units == "normalized" else 1.0
        bound = np.array([limit / self.action_scale], np.float32)
        entries = np.array(self.task.observation_bounds, np.float32)
        entries = np.concatenate([entries, np.tile(bound, action_history)])
        self.action_space = spaces.Box(-bound, bound, dtype=np.float32)
        self.observation_space = spaces.Box(-entries, entries, dtype=np.float32)
        self.graph = make_graph(
            object,
            self.engine,
            agent=TaskAgent(self.system, self.task, action_history, (self.action_scale,)),
            actuation_delay=actuation_delay,
            sensing_delay=sensing_delay,
            action_nodes=action_nodes,
        )
        if self.engine.real_time:
            self._runtime = WallClockRuntime(self.graph, record=False)
        else:
            # Each reset draws a timing of its own; without any the runtime would want constant delays.
            first = draw_timing(self.graph, torch.Generator(), 1, 1)
            self._runtime = SimulatedRuntime(self.graph, first, record=False)
        self._state: Any = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Start in ``options["initial_state"]`` (S,) or a start state drawn from the seed.

        Raises:
            SettingsError: The initial state has another shape.
        """
        super().reset(seed=seed)
        generator = torch.Generator().manual_seed(int(self.np_random.integers(2**62)))
        start = self.task.start(self.system, 1, generator)
        if options and options.get("initial_state") is not None:
            start = torch.as_tensor(np.asarray(options["initial_state"], np.float64))[None]
            if start.shape != (1, len(self.system.state_names)):
                names = ", ".join(self.system.state_names)
                raise SettingsError(f"initial_state has shape {tuple(start.shape[1:])}; give {names}")
        parameters = {**self.system.default_parameters(), "start": start}
        timing = None
        if not self.engine.real_time:
            timing = draw_timing(self.graph, generator, self.longest_episode, 1)
        names = ("world", "sensor")
        self._state, self._seen = self._runtime.reset(
            dict.fromkeys(names, parameters), generator, timing=timing
        )
        self._command = 0.0
        return self._observation(), self._info()

    def step(self, action: Any):
        if self._state is None:
            raise gymnasium.error.ResetNeeded("step before reset: call reset first")
        check_finite_action(np.asarray(action))
        limit = self.task.command_limit
        self._command = float(np.clip(np.asarray(action).item() * self.action_scale, -limit, limit))
        command = torch.tensor([[self._command]], dtype=torch.float64)
        self._state, self._seen = self._runtime.step(self._state, command)
        return self._observation(), float(self._state.readings["reward"]), False, False, self._info()

    def render(self) -> np.ndarray | None:
        """A picture of what was last seen of the object, uint8 (size, size, 3)."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() without a render mode: pass render_mode="rgb_array" to make()')
            return None
        truth = self._seen["truth"].data[0, -1].numpy()
        return self.system.draw(truth, self._command, self.render_size)

    def close(self) -> None:
        """Stop the engine; a unit's command is zero then."""
        self._state = None
        self._runtime.close()

    def _with_limits(self, engine: str | Engine) -> Engine:
        if isinstance(engine, Engine):
            return engine
        limits: dict[str, Any] = {"command_limit": self.task.command_limit}
        kind = type(find_engine(engine))
        if kind in (OdeEngine, MujocoEngine):
            limits["speed_limit"] = self.task.speed_limit
        return kind(**limits)

    def _observation(self) -> np.ndarray:
        return self._state.readings["observation"][0].numpy().astype(np.float32)

    def _info(self) -> dict[str, Any]:
        return {"angle_from_upright": float(self._state.readings["angle_from_upright"])}
