"""The package's own environments: a task on the delay graph, a batch at once and one alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from torch import Tensor

from deepkoco.engines.command_window import command_window, longest_further_delay
from deepkoco.engines.ode import World
from deepkoco.engines.sensor import Sensor
from deepkoco.envs.action_range import command_range, held_effort
from deepkoco.envs.graph_env import FIRST_STEPS, GraphEnv
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.nodes import TaskAgent
from deepkoco.envs.randomization import Randomization, Randomize, Values
from deepkoco.envs.settings import DELAYS, EnvironmentSettings, SettingsError
from deepkoco.envs.task_randomization import TaskRandomization
from deepkoco.graph import Connection, Graph
from deepkoco.graph.delay import Delay, Deterministic, make_delay
from deepkoco.graph.model.connection import wide_enough
from deepkoco.graph.model.node import State


class DelayGraphVectorEnv(GraphVectorEnv):
    """Environments of one task that step together on the delay graph.

    The reward is minus the task's cost of the true state and the command at the agent's tick; the
    observation is what the agent has received by then. Every environment draws delays and randomized
    parameters of its own at each episode. Episodes are cut after ``max_episode_steps``; they terminate only where
    the task has limits and the state leaves them.

    Args:
        num_envs: Environments B.
        max_episode_steps: Steps of an episode.
        render_mode: None or ``rgb_array``.
        render_size: Side of the pictures [pixels].
        delay_traces, executor, autoreset_mode: As for :class:`GraphVectorEnv`.
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
        delay_traces: int = 256,
        executor: str = "auto",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **settings: Any,
    ) -> None:
        self.settings = EnvironmentSettings(**settings)
        self.render_mode, self.render_size = render_mode, render_size
        self.task = self.settings.find_task()
        self.system = self.task.scene(self.settings.make_system())
        self.lowest, self.highest = command_range(self.task.command_limits, self.system)
        physical = self.settings.action_units == "physical"
        # An action of 0 is the middle of what a command can be, as with a thrust that only pushes.
        self.action_centre = np.zeros_like(self.highest) if physical else 0.5 * (self.lowest + self.highest)
        self.action_scale = np.ones_like(self.highest) if physical else 0.5 * (self.highest - self.lowest)
        low, high = (
            ((end - self.action_centre) / self.action_scale).astype(np.float32)
            for end in (self.lowest, self.highest)
        )
        entries = np.array(self.task.observation_bounds, np.float32)
        entries = np.tile(entries, 1 + self.settings.observation_history)
        past = np.tile(np.maximum(-low, high), self.settings.action_history)
        entries = np.concatenate([entries, past])
        super().__init__(
            num_envs,
            self._make_graph(),
            spaces.Box(low, high, dtype=np.float32),
            spaces.Box(-entries, entries, dtype=np.float32),
            max_episode_steps,
            randomize=self.settings.randomize,
            delay_traces=delay_traces,
            executor=executor,
            autoreset_mode=autoreset_mode,
        )
        self.metadata = {**self.metadata, "render_fps": round(self.task.control_rate)}

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Pictures of all environments, each uint8 (size, size, 3)."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() without a render mode: pass render_mode="rgb_array" to make()')
            return None
        seen = self.state.nodes["agent"]
        truth = self.system.ideal_measurement(seen["truth"].cpu()).numpy()
        pairs = zip(truth, seen["command"].cpu().numpy(), strict=True)
        return tuple(self.system.draw(state, command, self.render_size) for state, command in pairs)

    def draw_observation(self, observation: np.ndarray, image: np.ndarray) -> None:
        """Draw what one observation (N,) shows onto a picture, uint8 (size, size, 3), whatever that shows."""
        self.task.draw_observation(self.system, observation, image)

    def _make_graph(self) -> Graph:
        settings, rate = self.settings, self.task.control_rate
        sensing, actuation = (self._nominal_delay(name) for name in ("sensing_delay", "actuation_delay"))
        # Samples of the control rate are all that a constant delay lets the agent see; where delays differ
        # it sees the newest that has arrived, so there is one at every tick of the world.
        same = sensing.constant and not self._delays_differ("sensing_delay")
        sensor_rate = rate if same else settings.ticks_per_second
        noise = tuple(c.noise_sd if settings.noise else 0.0 for c in self.system.measurements)
        sensor = Sensor(self.system, sensor_rate, noise)
        world = World(
            self.system,
            settings.ticks_per_second,
            settings.integrator,
            self.task.command_limits,
            self.task.speed_limit,
        )
        nodes = [
            world,
            sensor,
            TaskAgent(
                self.system,
                self.task,
                settings.action_history,
                self.action_scale.tolist(),
                settings.observation_history,
                self.action_centre.tolist(),
            ),
        ]
        # The longest delay that one command can have, against the shortest that all can have.
        highest, lowest = self._ends_of_ranges(1), self._ends_of_ranges(0)
        further = longest_further_delay(self.system, highest)
        further += float(
            self.system.timing(highest).actuation_delay - self.system.timing(lowest).actuation_delay
        )
        window = command_window(actuation, rate, settings.ticks_per_second, further)
        connections = [
            wide_enough(Connection("world", "sensor"), world, sensor),
            Connection("world", "agent", name="truth"),
            Connection("agent", "world", delay=actuation, window=window, skip=True),
        ]
        if settings.estimator == "none":
            return Graph(nodes, [*connections, Connection("sensor", "agent", delay=sensing)])
        from deepkoco.envs.estimated import between_sensor_and_agent  # the fits are a second of imports

        own, joined = between_sensor_and_agent(
            self.system, self.task, settings, sensing, self._expected_actuation(), float(sensor_rate)
        )
        return Graph([*nodes, own], [*connections, *joined])

    def _delays_differ(self, name: str) -> bool:
        """Whether environments draw a delay of their own from a range."""
        return name in self.settings.randomize or f"{name}.delay" in self.settings.randomize

    def _nominal_delay(self, name: str) -> Delay:
        """Delay that the graph is laid out for: of a range the top, so that first messages arrive in time."""
        parameters, ranges = self._ends_of_ranges(1), self.settings.randomize
        own = float(getattr(self.system.timing(parameters), name))
        law = make_delay(ranges[name][1] if name in ranges else getattr(self.settings, name))
        if not law.constant and own != 0.0:
            raise SettingsError(
                f"{name}: the model has one of {own:g} s and the environment one that varies; put both into one law"
            )
        return law if own == 0.0 else Deterministic(float(law.mean) + own)

    def _expected_actuation(self) -> float:
        """Delay of the soonest command as a model expects it that does not know what is drawn: mid-range [s]."""
        given = self.settings.randomize.get("actuation_delay")
        own = float(self.system.timing(self.system.default_parameters()).actuation_delay)
        mean = float(make_delay(self.settings.actuation_delay).mean) if given is None else 0.5 * sum(given)
        return mean + own

    def _ends_of_ranges(self, end: int) -> dict[str, Tensor]:
        """Nominal parameters; of a range the bottom (0) or the top (1)."""
        ranges = self.settings.randomize
        return self.system.default_parameters() | {
            key: torch.as_tensor(span[end], dtype=torch.float64)
            for key, span in ranges.items()
            if key not in DELAYS
        }

    def _make_randomization(self, parameters: Values, randomize: Randomize) -> Randomization:
        return TaskRandomization(self.system, self.settings, self.graph)

    def _start(self, batch: int, generator: torch.Generator) -> dict[str, State]:
        start = self.task.start(self.system, batch, generator)
        world = {"state": start, **held_effort(self.task, self.system, batch)}
        return {"world": world, "sensor": {"start": start.clone()}}

    def _given(self, options: Mapping[str, Any]) -> Mapping[str, State]:
        if options.get("initial_state") is None:
            return {}
        start = torch.as_tensor(options["initial_state"], dtype=torch.float64)
        world = {"state": start, **held_effort(self.task, self.system, len(start))}
        return {"world": world, "sensor": {"start": start}}

    def _command(self, actions: Any) -> np.ndarray:
        # Two ufuncs cost a third of np.clip for few numbers.
        given = super()._command(actions) * self.action_scale + self.action_centre
        return np.minimum(np.maximum(given, self.lowest), self.highest)

    def command_of(self, actions: Tensor) -> Tensor:
        scale, centre, low, high = (
            torch.from_numpy(each)
            for each in (self.action_scale, self.action_centre, self.lowest, self.highest)
        )
        return (super().command_of(actions) * scale + centre).clamp(low, high)


class DelayGraphEnv(GraphEnv):
    """One environment on the delay graph; see :class:`DelayGraphVectorEnv` for the settings.

    It never cuts an episode: Gymnasium's own time limit does, as registered or as given to ``make``.

    Args:
        render_mode: None or ``rgb_array``.
        longest_episode: Steps for which delays are drawn; going on beyond them is an error. None: as many as
            turn out to be needed.
        **settings: Fields of :class:`EnvironmentSettings`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 - Gymnasium declares it so

    def __init__(
        self, render_mode: str | None = None, longest_episode: int | None = None, **settings: Any
    ) -> None:
        steps = FIRST_STEPS if longest_episode is None else longest_episode
        batch = DelayGraphVectorEnv(1, steps, render_mode, **settings)
        self._use(batch, longest_episode)
        self.render_mode = render_mode
        self.system, self.task = batch.system, batch.task

    def draw_observation(self, observation: np.ndarray, image: np.ndarray) -> None:
        """See :meth:`DelayGraphVectorEnv.draw_observation`."""
        self.task.draw_observation(self.system, observation, image)

    def _batched(self, options: Mapping[str, Any]) -> dict[str, Any]:
        if options.get("initial_state") is None:
            return super()._batched(options)
        return {**options, "initial_state": np.asarray(options["initial_state"])[None]}
