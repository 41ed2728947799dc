"""A pool whose thermometer sits behind a pipe, as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from torch import Tensor

from deepkoco.envs.graph_env import FIRST_STEPS, GraphEnv
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.pool import PoolOptions, pool_graph, pool_start
from deepkoco.envs.pool.seat import LARGEST, LOWEST_PUMP
from deepkoco.envs.randomization import Randomize
from deepkoco.envs.settings import SettingsError
from deepkoco.graph.model.node import State
from deepkoco.suggestion import did_you_mean
from deepkoco.systems.fluids import POOL_PARAMETERS, pool_parameters
from deepkoco.systems.fluids.pool_picture import draw_pool

HISTORY = 3
ENTRIES = 4  # of an observation, before the past actions
COLDEST, WARMEST = 28.0, 31.0  # start temperatures [deg C]
BELOW, ABOVE = -0.5, 1.5  # the goal against the start [K]
REFILL: Randomize = {"world.refill_heat": (0.0, 2e4), "world.refill_start": (300.0, 1500.0)}
"""Fresh cold water comes once in an episode: how much heat it takes [W], for 300 s, and when [s]."""


class PoolVectorEnv(GraphVectorEnv):
    """Pools that step together; see `deepkoco.systems.fluids.pool` for the physics and `PoolSeat` for what it pays.

    Actions (2,) in [-1, 1]: level of the heater from 0 to 1, level of the pump from 0.1 to 1. The slower the pump, the
    older the water at the thermometer: from 40 s to 400 s.

    Args:
        num_envs: Environments B.
        max_episode_steps: Steps of an episode, of 10 s each.
        filter: "none", or what a Kalman filter takes the measurements to be: see `deepkoco.envs.pool.FILTERS`.
        action_history: How many past actions are appended to the observation, newest first.
        noise: Thermometer and flow meter have noise.
        sensing_delay, actuation_delay: From the thermometer to the agent and from the agent to heater and pump, of
            messages: seconds, a law or its description; None takes the usual tenths of a second.
        randomize: As for :class:`GraphVectorEnv`, such as ``{"world.pipe_volume": (0.03, 0.1)}``; the refill is always
            drawn, from other ranges where they are given.
        render_mode: None or ``rgb_array``.
        render_size: Side of the pictures [pixels].
        delay_traces, executor, autoreset_mode: As for :class:`GraphVectorEnv`.

    Raises:
        SettingsError: A setting is wrong.
    """

    metadata = {  # noqa: RUF012 - Gymnasium declares it so
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        max_episode_steps: int = 200,
        filter: str = "none",
        action_history: int = HISTORY,
        noise: bool = True,
        sensing_delay: Any = None,
        actuation_delay: Any = None,
        randomize: Randomize | None = None,
        render_mode: str | None = None,
        render_size: int = 256,
        delay_traces: int = 256,
        executor: str = "auto",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        for name, number, least in (("action_history", action_history, 0), ("render_size", render_size, 16)):
            if not isinstance(number, int) or isinstance(number, bool) or number < least:
                raise SettingsError(f"{name} = {number!r}; give a whole number from {least} on")
        if not isinstance(noise, bool):
            raise SettingsError(f"noise = {noise!r}; give True or False")
        _check_ranges(randomize or {})
        try:
            options = PoolOptions(
                filter=filter,
                noise=noise,
                history=action_history,
                sensing_delay=sensing_delay,
                actuation_delay=actuation_delay,
            )
            graph = pool_graph(options)
        except ValueError as error:
            raise SettingsError(str(error)) from error
        self.render_mode, self.render_size = render_mode, render_size
        bound = np.concatenate([np.full(ENTRIES, LARGEST), np.ones(2 * action_history)]).astype(np.float32)
        super().__init__(
            num_envs,
            graph,
            spaces.Box(-1.0, 1.0, (2,), np.float32),
            spaces.Box(-bound, bound, dtype=np.float32),
            max_episode_steps,
            parameters=pool_parameters(),
            randomize={**REFILL, **(randomize or {})},
            delay_traces=delay_traces,
            executor=executor,
            autoreset_mode=autoreset_mode,
        )

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Pictures of all environments, each uint8 (size, size, 3)."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() without a render mode: pass render_mode="rgb_array" to make()')
            return None
        nodes = {name: {k: v.cpu().numpy() for k, v in own.items()} for name, own in self.state.nodes.items()}
        world = nodes["world"]
        scale = {name: float(own["scale"]) for name, own in pool_parameters().items() if "scale" in own}
        return tuple(
            draw_pool(
                float(world["temperature"][b]),
                world["edges"][b],
                world["values"][b, :, 0],
                float(nodes["heater"]["delivered"][b]) / scale["heater"],
                float(nodes["pump"]["delivered"][b]) / scale["pump"],
                float(nodes["agent"]["goal"][b]),
                self.render_size,
            )
            for b in range(self.num_envs)
        )

    def _start(self, batch: int, generator: torch.Generator) -> dict[str, State]:
        drawn = torch.rand(2, batch, generator=generator, dtype=torch.float64)
        temperature = COLDEST + (WARMEST - COLDEST) * drawn[0]
        return pool_start(self.graph, temperature, temperature + BELOW + (ABOVE - BELOW) * drawn[1])

    def _given(self, options: Mapping[str, Any]) -> Mapping[str, State]:
        """``options["temperature"]`` and ``options["goal"]``, (B,) each, beside ``initial``."""
        known = ("temperature", "goal", "initial")
        if wrong := [name for name in options if name not in known]:
            raise SettingsError(f'there is no option "{wrong[0]}"{did_you_mean(wrong[0], known) or ""}')
        if options.get("temperature") is None and options.get("goal") is None:
            return super()._given(options)
        if options.get("temperature") is None or options.get("goal") is None:
            raise SettingsError("a start needs both temperature and goal [deg C]")
        return pool_start(self.graph, *(self._degrees(name, options[name]) for name in known[:2]))

    def _degrees(self, name: str, value: Any) -> Tensor:
        try:
            given = np.broadcast_to(np.asarray(value, dtype=np.float64), (self.num_envs,))
        except (TypeError, ValueError):
            given = np.full(1, np.nan)
        if not np.isfinite(given).all():
            raise SettingsError(f"{name} = {value!r}; give one number or {self.num_envs} [deg C]")
        return torch.tensor(given)

    def _command(self, actions: Any) -> np.ndarray:
        share = 0.5 * (np.clip(super()._command(actions), -1.0, 1.0) + 1.0)
        return LOWEST + (1.0 - LOWEST) * share

    def command_of(self, actions: Tensor) -> Tensor:
        share = 0.5 * (super().command_of(actions).clamp(-1.0, 1.0) + 1.0)
        low = torch.from_numpy(LOWEST)
        return low + (1.0 - low) * share


def _check_ranges(randomize: Randomize) -> None:
    """Refuse ranges of parameters that go beyond what these may be.

    Raises:
        SettingsError: One does.
    """
    declared = {f"{node}.{p.name}": p for node, parameters in POOL_PARAMETERS.items() for p in parameters}
    for name, span in randomize.items():
        p = declared.get(name)
        if (
            p is not None
            and isinstance(span, tuple | list)
            and not all(p.low <= end <= p.high for end in span)
        ):
            raise SettingsError(f"{name}: {tuple(span)} goes beyond {p.low:g} to {p.high:g} {p.unit}")


LOWEST = np.array([0.0, LOWEST_PUMP])


class PoolEnv(GraphEnv):
    """One pool; see :class:`PoolVectorEnv` for the settings.

    It never cuts an episode: Gymnasium's own time limit does, as registered or as given to ``make``.

    Args:
        render_mode: None or ``rgb_array``.
        longest_episode: Steps for which delays are drawn; going on beyond them is an error. None: as many as
            turn out to be needed.
        **settings: As for :class:`PoolVectorEnv`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - Gymnasium declares it so

    def __init__(
        self, render_mode: str | None = None, longest_episode: int | None = None, **settings: Any
    ) -> None:
        steps = FIRST_STEPS if longest_episode is None else longest_episode
        self._use(PoolVectorEnv(1, steps, render_mode=render_mode, **settings), longest_episode)
        self.render_mode = render_mode
