"""Gymnasium environments on the delay graph: a batch at once, and one alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from deepkoco.envs.nodes import Sensor, World
from deepkoco.envs.settings import DELAYS, EnvironmentSettings, SettingsError
from deepkoco.graph import BatchedRuntime, Connection, Graph, HorizonError, Supervisor, draw_timing
from deepkoco.graph.delay import Delay, Deterministic, make_delay

EDGES = {"actuation_delay": "agent->world", "sensing_delay": "sensor->agent"}


class DelayGraphVectorEnv(VectorEnv):
    """Environments of one task that step together on the delay graph.

    The reward is minus the task's cost of the true state and the command at the agent's tick; the
    observation is what the agent has received by then. Every environment draws delays and randomized
    parameters of its own at each episode. Episodes are cut after ``max_episode_steps`` and never
    terminate; all start together, as next-step autoreset does for episodes of one length.

    Args:
        num_envs: Environments B.
        max_episode_steps: Steps of an episode.
        render_mode: None or ``rgb_array``.
        render_size: Side of the pictures [pixels].
        **settings: Fields of :class:`EnvironmentSettings`.

    Raises:
        ValueError: A setting is wrong; the message says which and what it may be.
    """

    metadata = {  # noqa: RUF012 - Gymnasium declares it so
        "render_modes": ["rgb_array"],
        "render_fps": 20,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        max_episode_steps: int = 200,
        render_mode: str | None = None,
        render_size: int = 256,
        **settings: Any,
    ) -> None:
        self.settings = EnvironmentSettings(**settings)
        self.num_envs, self.max_episode_steps = num_envs, max_episode_steps
        self.render_mode, self.render_size = render_mode, render_size
        self.system = self.settings.make_system()
        self.task = self.settings.task
        self.metadata = {**self.metadata, "render_fps": round(self.task.control_rate)}
        limit = self.task.command_limit
        self.action_scale = limit if self.settings.action_units == "normalized" else 1.0
        bound = np.array([limit / self.action_scale], np.float32)
        self.single_action_space = spaces.Box(-bound, bound, dtype=np.float32)
        entries = np.array(self.task.observation_bounds, np.float32)
        entries = np.concatenate([entries, np.tile(bound, self.settings.action_history)])
        self.single_observation_space = spaces.Box(-entries, entries, dtype=np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.graph = self._make_graph()
        self._generator = torch.Generator()
        self._runtime: BatchedRuntime | None = None

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None):  # pyright: ignore[reportIncompatibleMethodOverride]
        """Start new episodes.

        Args:
            seed: Seed of every draw; None goes on with the draws of before.
            options: ``initial_state`` (B, S), start states in place of drawn ones.
        """
        if seed is not None:
            super().reset(seed=seed)
        elif self._np_random is None:
            super().reset(seed=int(np.random.SeedSequence().generate_state(1)[0]))
        self._generator.manual_seed(int(self.np_random.integers(2**62)))
        self._parameters, delays = self._draw_parameters()
        timing = draw_timing(self.graph, self._generator, self.max_episode_steps, self.num_envs, delays)
        self._runtime = BatchedRuntime(self.graph, timing)
        parameters = {node.name: self._parameters for node in self.graph.nodes}
        start = self.task.start(self.system, self.num_envs, self._generator)
        if options and options.get("initial_state") is not None:
            start = torch.as_tensor(options["initial_state"], dtype=torch.float64)
        initial = {"world": {"state": start}, "sensor": {"start": start}}
        self._state, inputs = self._runtime.reset(parameters, self._generator, initial)
        self._history = torch.zeros(self.num_envs, self.settings.action_history, dtype=torch.float64)
        self._command = torch.zeros(self.num_envs, dtype=torch.float64)
        self._elapsed = 0
        self._take(inputs)
        return self._observation(), self._info()

    def step(self, actions: np.ndarray):
        """Send the actions (B, 1) and go on to the agent's next tick."""
        if self._runtime is None:
            raise gymnasium.error.ResetNeeded("step before reset: call reset first")
        if self.episode_over:
            observation, info = self.reset()
            nothing = np.zeros(self.num_envs, bool)
            return observation, np.zeros(self.num_envs), nothing, nothing.copy(), info
        action = torch.as_tensor(np.asarray(actions), dtype=torch.float64).reshape(self.num_envs, 1)
        limit = self.task.command_limit
        self._command = (action[:, 0] * self.action_scale).clamp(-limit, limit)
        cost = self.task.cost(self.system, self._truth, self._command)
        if self._history.shape[1]:
            newest = self._command[:, None] / self.action_scale
            self._history = torch.cat([newest, self._history[:, :-1]], 1)
        self._state, inputs = self._runtime.step(self._state, self._command[:, None])
        self._take(inputs)
        self._elapsed += 1
        terminated = np.zeros(self.num_envs, bool)
        truncated = np.full(self.num_envs, self.episode_over)
        return self._observation(), -cost.numpy(), terminated, truncated, self._info()

    @property
    def episode_over(self) -> bool:
        """Whether the last step was the last of its episode."""
        return self._elapsed >= self.max_episode_steps

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Pictures of all environments, each uint8 (size, size, 3)."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() without a render mode: pass render_mode="rgb_array" to make()')
            return None
        pairs = zip(self._truth.numpy(), self._command.tolist(), strict=True)
        return tuple(self.system.draw(state, command, self.render_size) for state, command in pairs)

    def _make_graph(self) -> Graph:
        settings, rate = self.settings, self.task.control_rate
        sensing, actuation = (self._nominal_delay(name) for name in ("sensing_delay", "actuation_delay"))
        # Samples of the control rate are all that a constant delay lets the agent see; where delays differ
        # it sees the newest that has arrived, so there is one at every tick of the world.
        same = sensing.constant and not self._delays_differ("sensing_delay")
        sensor_rate = rate if same else settings.world_rate
        samples = math.ceil((self.max_episode_steps + 2) * sensor_rate / rate)
        noise = tuple(c.noise_sd if settings.noise else 0.0 for c in self.system.measurements)
        nodes = [
            World(self.system, self.task, settings.world_rate, settings.integrator),
            Sensor(self.system, sensor_rate, noise, samples),
            Supervisor("agent", rate, initial_action=torch.zeros(1, dtype=torch.float64)),
        ]
        # Commands under way at a tick of the world may all arrive within it, and the one before them still
        # holds; with a constant delay they keep their distance.
        spread = 0.0 if actuation.constant else actuation.highest
        window = 2 + math.ceil((spread + 1.0 / settings.world_rate) * rate)
        connections = [
            Connection("world", "sensor"),
            Connection("world", "agent", name="truth"),
            Connection("sensor", "agent", delay=sensing),
            Connection("agent", "world", delay=actuation, window=window, skip=True),
        ]
        return Graph(nodes, connections)

    def _delays_differ(self, name: str) -> bool:
        """Whether environments draw a delay of their own from a range."""
        return name in self.settings.randomize or f"{name}.delay" in self.settings.randomize

    def _nominal_delay(self, name: str) -> Delay:
        """Delay that the graph is laid out for: of a range the top, so that first messages arrive in time."""
        parameters, ranges = self.system.default_parameters(), self.settings.randomize
        parameters |= {
            key: torch.as_tensor(high, dtype=torch.float64)
            for key, (_, high) in ranges.items()
            if key not in DELAYS
        }
        own = float(getattr(self.system.timing(parameters), name))
        law = make_delay(ranges[name][1] if name in ranges else getattr(self.settings, name))
        if not law.constant and own != 0.0:
            raise SettingsError(
                f"{name}: the model has one of {own:g} s and the environment a random one; put both into one law"
            )
        return law if own == 0.0 else Deterministic(float(law.mean) + own)

    def _draw_parameters(self) -> tuple[dict[str, Tensor], dict[str, np.ndarray]]:
        """Parameters of this episode, and the delays that differ between environments."""
        parameters = self.system.default_parameters()
        ranges = self.settings.randomize
        drawn = {
            name: low
            + (high - low) * torch.rand(self.num_envs, generator=self._generator, dtype=torch.float64)
            for name, (low, high) in ranges.items()
        }
        self._draws = {name: value.numpy() for name, value in drawn.items()}
        parameters |= {name: value for name, value in drawn.items() if name not in DELAYS}
        timing = self.system.timing(parameters)
        delays = {}
        for name, own in zip(DELAYS, (timing.actuation_delay, timing.sensing_delay), strict=True):
            if name in drawn or own.ndim > 0:
                law = make_delay(getattr(self.settings, name))
                base = drawn[name] if name in drawn else torch.tensor(float(law.mean), dtype=torch.float64)
                delays[EDGES[name]] = (base + own).expand(self.num_envs).numpy()
        return parameters, delays

    def _take(self, inputs: Mapping[str, Any]) -> None:
        self._truth = inputs["truth"].data[:, -1]
        self._measured = inputs["sensor"].data[:, -1]

    def _observation(self) -> np.ndarray:
        observation = self.task.observation(self.system, self._measured)
        return torch.cat([observation, self._history], -1).numpy().astype(np.float32)

    def _info(self) -> dict[str, Any]:
        angle = self.task.angle_from_upright(self.system, self._truth)
        return {"angle_from_upright": angle.numpy(), "_angle_from_upright": np.ones(self.num_envs, bool)}


class DelayGraphEnv(gymnasium.Env):
    """One environment on the delay graph; see :class:`DelayGraphVectorEnv` for the settings.

    It never cuts an episode: Gymnasium's own time limit does, as registered or as given to ``make``.

    Args:
        render_mode: None or ``rgb_array``.
        longest_episode: Steps for which delays are drawn; going on beyond them is an error.
        **settings: Fields of :class:`EnvironmentSettings`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 - Gymnasium declares it so

    def __init__(self, render_mode: str | None = None, longest_episode: int = 1000, **settings: Any) -> None:
        self._batch = DelayGraphVectorEnv(1, longest_episode, render_mode, **settings)
        self.render_mode = render_mode
        self.system, self.task = self._batch.system, self._batch.task
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": self._batch.metadata["render_fps"],
        }
        self.action_space = self._batch.single_action_space
        self.observation_space = self._batch.single_observation_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        if options and options.get("initial_state") is not None:
            options = {**options, "initial_state": np.asarray(options["initial_state"])[None]}
        observation, info = self._batch.reset(
            seed=int(self.np_random.integers(2**31)) if seed is None else seed, options=options
        )
        return observation[0], _first(info)

    def step(self, action: np.ndarray):
        if self._batch.episode_over:
            raise HorizonError(
                f"the episode goes on beyond longest_episode = {self._batch.max_episode_steps} steps; "
                "give a larger one to make()"
            )
        observation, reward, _, _, info = self._batch.step(np.asarray(action)[None])
        return observation[0], float(reward[0]), False, False, _first(info)

    def render(self) -> np.ndarray | None:
        pictures = self._batch.render()
        return None if pictures is None else pictures[0]


def _first(info: Mapping[str, Any]) -> dict[str, Any]:
    return {name: float(value[0]) for name, value in info.items() if not name.startswith("_")}
