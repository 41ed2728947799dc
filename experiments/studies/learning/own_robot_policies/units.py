"""Units: the cart-pole and the motor of the oracle, and an arm in MuJoCo. None of the package's dynamics is used."""

from __future__ import annotations

from collections import deque
from typing import Any, Protocol

import gymnasium
import mujoco
import numpy as np
import torch
from gymnasium import spaces

from deepkoco.envs.tasks import Task
from deepkoco.systems import System
from tests.oracle.mujoco_robots import Robot, random_arm
from tests.oracle.mujoco_unit import Hidden, unit_model
from tests.oracle.own_robots import CartPoleUnit, MotorUnit

ARM_SEED, ARM_JOINTS = 30002, 2
ARM_STEP = 2e-4  # of MuJoCo [s]


class Unit(Protocol):
    """A machine whose true state can be set and read."""

    state: np.ndarray

    def reset(self, state: np.ndarray) -> None:
        """Put the machine into a state (S,), at zero command."""

    def advance(self, command: np.ndarray, period: float) -> None:
        """Hold the commands (M,) for a time [s]."""


class EquationUnit:
    """A unit of the oracle, given by its slope.

    Args:
        unit: A `CartPoleUnit` or a `MotorUnit`.
        states: Length of its state.
        step: Of the classical Runge-Kutta method [s].
    """

    def __init__(self, unit: CartPoleUnit | MotorUnit, states: int, step: float) -> None:
        self.unit, self.step = unit, step
        self.state = np.zeros(states)
        self._late = round(unit.delay / step)
        self._sent: deque[float] = deque()

    def reset(self, state: np.ndarray) -> None:
        """As :class:`Unit`."""
        self.state = np.array(state, dtype=float)
        self._sent = deque([0.0] * self._late)

    def advance(self, command: np.ndarray, period: float) -> None:
        """As :class:`Unit`."""
        h, slope = self.step, self.unit._slope
        for _ in range(round(period / h)):
            self._sent.append(float(command[0]))
            u, x = self._sent.popleft(), self.state
            k1 = slope(x, u)
            k2 = slope(x + 0.5 * h * k1, u)
            k3 = slope(x + 0.5 * h * k2, u)
            k4 = slope(x + h * k3, u)
            self.state = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


class MujocoUnit:
    """A unit that MuJoCo simulates.

    Args:
        model: With what it hides.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.state = np.zeros(2 * model.nv)

    def reset(self, state: np.ndarray) -> None:
        """As :class:`Unit`."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = np.split(np.asarray(state, dtype=float), 2)
        self.state = np.array(state, dtype=float)

    def advance(self, command: np.ndarray, period: float) -> None:
        """As :class:`Unit`."""
        self.data.ctrl[:] = command
        mujoco.mj_step(self.model, self.data, round(period / self.model.opt.timestep))
        self.state = np.concatenate([self.data.qpos, self.data.qvel])


def arm() -> Robot:
    """The arm as the user has it in a file."""
    return random_arm(np.random.default_rng(ARM_SEED), ARM_JOINTS, "motor")


def arm_hidden() -> Hidden:
    """What the arm hides: dry friction at the first joint, a quarter of its largest torque."""
    return Hidden("frictionloss", "j1", round(0.25 * arm().sizes[0], 4))


def arm_model(hidden: Hidden | None) -> mujoco.MjModel:
    """The unit's model in MuJoCo; every unit differs a little from its file."""
    return unit_model(arm(), hidden, ARM_SEED, ARM_STEP)


def true_arm() -> str:
    """The unit's model as a file: the arm with all that the user does not know."""
    model, spec = arm_model(arm_hidden()), mujoco.MjSpec.from_string(arm().xml)
    for b, body in enumerate(spec.bodies):
        body.mass, body.inertia = model.body_mass[b], model.body_inertia[b]
    for j, joint in enumerate(spec.joints):
        joint.damping = np.array([model.dof_damping[j], 0.0, 0.0])
        joint.frictionloss, joint.armature = model.dof_frictionloss[j], model.dof_armature[j]
    spec.compile()
    return spec.to_xml()


class UnitEnv(gymnasium.Env):
    """A task on a unit: what the agent sees are its sensors, what it pays is decided by its true state.

    Args:
        unit: The unit.
        system: The model as given: names and units of states and sensors.
        task: The task.
        steps: Of an episode.
        history: Past actions that are appended to the observation.
    """

    def __init__(self, unit: Unit, system: System, task: Task, steps: int, history: int) -> None:
        self.unit, self.steps, self.history = unit, steps, history
        self.scene = task.scene(system)
        self.task = task.on(self.scene)
        self.limits = np.array(self.task.command_limits)
        count = len(self.task.observation_names) + history * len(self.limits)
        self.observation_space = spaces.Box(-np.inf, np.inf, (count,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, self.limits.shape, np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict]:
        """Start an episode."""
        super().reset(seed=seed)
        generator = torch.Generator().manual_seed(int(self.np_random.integers(2**62)))
        self.unit.reset(self.task.start(self.scene, 1, generator)[0].numpy())
        self._past, self._done = np.zeros(self.history * len(self.limits)), 0
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Hold an action for one period of the agent."""
        taken = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        command = taken * self.limits
        before = torch.from_numpy(self.unit.state)
        cost = float(self.task.cost(self.scene, before, torch.from_numpy(command)))
        self.unit.advance(command, 1.0 / self.task.control_rate)
        left = self.task.left(self.scene, torch.from_numpy(self.unit.state))
        outside = left is not None and bool(left)
        cost += self.task.leaving_cost * outside
        self._done += 1
        if self.history:
            self._past = np.concatenate([taken, self._past[: -len(taken)]])
        return self._observation(), -cost, outside, self._done >= self.steps, {}

    def _observation(self) -> np.ndarray:
        true = self.scene.ideal_measurement(torch.from_numpy(self.unit.state))
        noise = np.array([c.noise_sd for c in self.scene.measurements]) * self.np_random.standard_normal(
            len(true)
        )
        seen = self.task.observation(self.scene, true + torch.from_numpy(noise)).numpy()
        return np.concatenate([seen, self._past]).astype(np.float32)
