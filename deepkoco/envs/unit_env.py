"""A unit as a Gymnasium environment: real time, one step per control period."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces

from deepkoco.envs.actions import check_finite_action
from deepkoco.envs.settings import ACTION_UNITS, SettingsError
from deepkoco.envs.tasks import SWING_UPS
from deepkoco.systems import JointSystem, make_system
from deepkoco.unit import ControlLoop, SimulatedUnit, Unit, UnitSpec, load_unit
from deepkoco.unit.messages import SensorMessage


class UnitEnv(gymnasium.Env):
    """Runs a task on a unit, in wall-clock time unless told otherwise.

    ``step`` sends the command, waits for the next control tick and returns the last measurement, so it
    takes one control period. The reward is minus the task's cost of the last measurement and the
    command, because the true state of a unit is not known. ``info`` has the ``time`` of the tick [s] and the
    ``observation_age`` [s], which follows from the number of the sample. Close the environment to stop the unit.

    Args:
        unit: Path of a UNIT.yaml or a spec.
        clock: ``wall``: the unit's own process in real time; ``simulated``: virtual time, faster.
        episode_steps: Steps after which the episode is cut.
        action_units: ``normalized`` or ``physical``, as in the simulated environments.
        action_history: How many past actions are appended to the observation, newest first.
        observation_history: How many past observations are appended before the actions, newest first.
        render_mode: None or ``rgb_array``, drawn from the last measurement.
        render_size: Side of the picture [pixels].

    Raises:
        SettingsError: The clock or the units of the actions are unknown.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 - Gymnasium declares it so

    def __init__(
        self,
        unit: str | Path | UnitSpec,
        clock: str = "wall",
        episode_steps: int = 200,
        action_units: str = "physical",
        action_history: int = 0,
        render_mode: str | None = None,
        render_size: int = 256,
        observation_history: int = 0,
    ) -> None:
        clocks = {"wall": Unit, "simulated": SimulatedUnit}
        for what, value, known in (("clock", clock, clocks), ("action_units", action_units, ACTION_UNITS)):
            if value not in known:
                raise SettingsError(f'{what} "{value}" is none of {", ".join(known)}')
        spec = unit if isinstance(unit, UnitSpec) else load_unit(unit)
        system = make_system(spec.system)
        assert isinstance(system, JointSystem)
        self.system, self.task, self.episode_steps = system, SWING_UPS[spec.system], episode_steps
        self.render_mode, self.render_size = render_mode, render_size
        limit = self.task.command_limit
        self.action_scale = limit if action_units == "normalized" else 1.0
        bound = np.array([limit / self.action_scale], np.float32)
        self.action_space = spaces.Box(-bound, bound, dtype=np.float32)
        entries = np.array(self.task.observation_bounds, np.float32)
        entries = np.tile(entries, 1 + observation_history)
        self._past = np.zeros((observation_history, len(self.task.observation_bounds)))
        entries = np.concatenate([entries, np.tile(bound, action_history)])
        self._history = np.zeros(action_history, np.float32)
        self.observation_space = spaces.Box(-entries, entries, dtype=np.float32)
        self._unit = clocks[clock](spec)
        self._loop: ControlLoop | None = None

    @property
    def timing(self) -> dict[str, float]:
        """Timing of the episode so far: steps, overruns, periods [s], lost samples."""
        return {} if self._loop is None else dict(vars(self._loop.stats))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Put the unit into ``options["initial_state"]`` (S,) or a start state drawn from the seed.

        In simulated time the seed also starts the unit's noise and jitter.
        """
        super().reset(seed=seed)
        if seed is not None and isinstance(self._unit, SimulatedUnit):
            self._unit.seed_noise(seed)
        if options and options.get("initial_state") is not None:
            state = np.asarray(options["initial_state"], np.float64)
        else:
            generator = torch.Generator().manual_seed(int(self.np_random.integers(2**62)))
            state = self.task.start(self.system, 1, generator)[0].numpy()
        if self._loop is None:
            self._unit.__enter__()
            self._loop = ControlLoop(self._unit, self.task.control_rate)
        self._take(self._loop.reset((float(state[0]), float(state[1]))))
        self._elapsed, self._command = 0, 0.0
        self._history[:], self._past[:] = 0.0, 0.0
        return self._observation(), self._info()

    def step(self, action: np.ndarray):
        if self._loop is None:
            raise gymnasium.error.ResetNeeded("step before reset: call reset first")
        check_finite_action(np.asarray(action))
        limit = self.task.command_limit
        self._command = float(np.clip(np.asarray(action).item() * self.action_scale, -limit, limit))
        command = torch.tensor([self._command], dtype=torch.float64)
        cost = float(self.task.cost(self.system, self._measured, command))
        self._history = np.append(self._command / self.action_scale, self._history)[: len(self._history)]
        self._take(self._loop.step(self._command))
        self._elapsed += 1
        return self._observation(), -cost, False, self._elapsed >= self.episode_steps, self._info()

    def render(self) -> np.ndarray | None:
        if self.render_mode is None:
            gymnasium.logger.warn('render() without a render mode: pass render_mode="rgb_array"')
            return None
        return self.system.draw(self._measured.numpy(), self._command, self.render_size)

    def close(self) -> None:
        """Stop the unit."""
        self._loop = None
        self._unit.close()

    def _take(self, message: SensorMessage) -> None:
        self._measured = torch.tensor(message.values, dtype=torch.float64)
        self._time = self._unit.now()
        self._age = max(0.0, self._time - message.seq / self._unit.spec.sensor.rate_hz)

    def _observation(self) -> np.ndarray:
        observation = self.task.observation(self.system, self._measured).numpy()
        seen = np.concatenate([observation[None], self._past])
        self._past = seen[:-1]
        return np.concatenate([seen.ravel(), self._history]).astype(np.float32)

    def _info(self) -> dict[str, Any]:
        away = float(self.task.angle_from_upright(self.system, self._measured))
        return {"angle_from_upright": away, "time": self._time, "observation_age": self._age}
