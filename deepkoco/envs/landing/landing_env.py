"""A quadrotor that lands on a moving, inclined deck, as a Gymnasium environment."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from torch import Tensor

from deepkoco.envs.graph_env import FIRST_STEPS, GraphEnv
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.landing.landing_graph import (
    CONTROL_RATE,
    DECK_DELAY,
    LandingOptions,
    landing_graph,
    landing_start,
)
from deepkoco.envs.landing.seat import BOUNDS, CENTRE, SCALE
from deepkoco.envs.randomization import Randomize
from deepkoco.envs.settings import SettingsError, check_range
from deepkoco.graph.model.node import State
from deepkoco.suggestion import did_you_mean
from deepkoco.systems import make_system
from deepkoco.systems.landing import DECK_PARAMETERS, deck_parameters
from deepkoco.systems.landing.landing_picture import draw_landing
from deepkoco.systems.landing.moving_deck import STEEPEST_INCLINE

HISTORY = 10
INCLINE = (0.0, math.radians(25.0))
SPEED = (0.0, 1.0)
FASTEST = 3.0  # deck [m/s]
OPTIONS = ("incline", "speed", "initial")


class LandingVectorEnv(GraphVectorEnv):
    """Quadrotors that land on moving, inclined decks, side by side; see `LandingSeat` for what is seen and paid.

    Actions (3,) in [-1, 1]: thrust from 0 to 0.62 N, roll and pitch from -0.5 to 0.5 rad.

    Args:
        num_envs: Environments B.
        max_episode_steps: Steps of an episode, of 20 ms each.
        incline: Between these two, drawn for every episode [rad].
        speed: Of the deck, likewise [m/s].
        action_history: How many past actions are appended to the observation, newest first.
        noise: Both sensors have noise.
        sensing_delay, deck_delay, actuation_delay: As for `LandingOptions`: seconds, a law or its description.
        parameters: Of the body, in the place of nominal ones.
        randomize: As for :class:`GraphVectorEnv`, such as ``{"world.mass": (0.03, 0.036)}`` or
            ``{"deck_sensor->agent": (0.03, 0.07)}``.
        render_mode: None or ``rgb_array``.
        render_size: Side of the pictures [pixels].
        delay_traces, executor, autoreset_mode: As for :class:`GraphVectorEnv`.

    Raises:
        SettingsError: A setting is wrong.
    """

    metadata = {  # noqa: RUF012 - Gymnasium declares it so
        "render_modes": ["rgb_array"],
        "render_fps": round(CONTROL_RATE),
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        max_episode_steps: int = 200,
        incline: Sequence[float] = INCLINE,
        speed: Sequence[float] = SPEED,
        action_history: int = HISTORY,
        noise: bool = True,
        sensing_delay: Any = 0.0,
        deck_delay: Any = DECK_DELAY,
        actuation_delay: Any = 0.0,
        parameters: Mapping[str, float] | None = None,
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
        check_range("incline", incline, 0.0, STEEPEST_INCLINE, "rad")
        check_range("speed", speed, 0.0, FASTEST, "m/s")
        self._incline, self._speed = ((float(low), float(high)) for low, high in (incline, speed))
        system, randomize = make_system("quadrotor"), dict(randomize or {})
        own = system.default_parameters()
        for name, value in (parameters or {}).items():
            system.parameter(name)
            own[name] = torch.tensor(float(value), dtype=torch.float64)
        declared = {"world": system.parameters, "deck": DECK_PARAMETERS}
        for node, known in declared.items():
            for p in known:
                if (span := randomize.get(f"{node}.{p.name}")) is not None:
                    check_range(f"{node}.{p.name}", span, p.low, p.high, p.unit)
        delays = {f"{command}_delay" for command in ("thrust", "roll", "pitch")}
        longest = max(max(float(own[n]), *map(float, randomize.get(f"world.{n}", (0.0,)))) for n in delays)
        try:
            options = LandingOptions(
                history=action_history, noise=noise, sensing_delay=sensing_delay, deck_delay=deck_delay,
                actuation_delay=actuation_delay, longest_delay=longest,
            )  # fmt: skip
            graph = landing_graph(options)
        except ValueError as error:
            raise SettingsError(str(error)) from error
        self.render_mode, self.render_size = render_mode, render_size
        self.action_centre, self.action_scale = np.array(CENTRE), np.array(SCALE)
        bound = np.concatenate([BOUNDS, np.ones(len(SCALE) * action_history)]).astype(np.float32)
        super().__init__(
            num_envs,
            graph,
            spaces.Box(-1.0, 1.0, (len(SCALE),), np.float32),
            spaces.Box(-bound, bound, dtype=np.float32),
            max_episode_steps,
            parameters={"world": own, "sensor": own, "deck": deck_parameters()},
            randomize=randomize,
            delay_traces=delay_traces,
            executor=executor,
            autoreset_mode=autoreset_mode,
        )

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Pictures of all environments, each uint8 (size, size, 3)."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() without a render mode: pass render_mode="rgb_array" to make()')
            return None
        seen = {name: value.cpu().numpy() for name, value in self.state.nodes["touchdown"].items()}
        deck = self.state.nodes["deck"]
        steady = np.stack([deck["x"].cpu().numpy(), deck["y"].cpu().numpy()], -1)
        return tuple(
            draw_landing(
                seen["way"][b],
                seen["axis"][b],
                seen["normal"][b],
                steady[b],
                bool(seen["touched"][b]),
                self.render_size,
            )
            for b in range(self.num_envs)
        )

    def _start(self, batch: int, generator: torch.Generator) -> dict[str, State]:
        drawn = torch.rand(2, batch, generator=generator, dtype=torch.float64)
        spans = (self._incline, self._speed)
        incline, speed = (low + (high - low) * unit for (low, high), unit in zip(spans, drawn, strict=True))
        return landing_start(incline, speed, generator)

    def _given(self, options: Mapping[str, Any]) -> Mapping[str, State]:
        """``options["incline"]`` [rad] and ``options["speed"]`` [m/s], one number or (B,) each, beside ``initial``."""
        if wrong := [name for name in options if name not in OPTIONS]:
            raise SettingsError(f'there is no option "{wrong[0]}"{did_you_mean(wrong[0], OPTIONS) or ""}')
        if options.get("incline") is None and options.get("speed") is None:
            return super()._given(options)
        if options.get("incline") is None or options.get("speed") is None:
            raise SettingsError("a deck needs both incline [rad] and speed [m/s]")
        incline = self._numbers("incline", options["incline"], STEEPEST_INCLINE)
        speed = self._numbers("speed", options["speed"], FASTEST)
        generator = torch.Generator().manual_seed(int(self.np_random.integers(2**62)))
        return landing_start(incline, speed, generator)

    def _numbers(self, name: str, value: Any, top: float) -> Tensor:
        try:
            given = np.broadcast_to(np.asarray(value, dtype=np.float64), (self.num_envs,))
        except (TypeError, ValueError):
            given = np.full(1, np.nan)
        if not ((given >= 0.0) & (given <= top)).all():
            raise SettingsError(f"{name} = {value!r}; give one number or {self.num_envs}, from 0 to {top:g}")
        return torch.tensor(given)

    def _command(self, actions: Any) -> np.ndarray:
        return np.clip(super()._command(actions), -1.0, 1.0) * self.action_scale + self.action_centre

    def command_of(self, actions: Tensor) -> Tensor:
        scale, centre = torch.from_numpy(self.action_scale), torch.from_numpy(self.action_centre)
        return super().command_of(actions).clamp(-1.0, 1.0) * scale + centre


class LandingEnv(GraphEnv):
    """One landing; see :class:`LandingVectorEnv` for the settings.

    It never cuts an episode: Gymnasium's own time limit does, as registered or as given to ``make``.

    Args:
        render_mode: None or ``rgb_array``.
        longest_episode: Steps for which delays are drawn; going on beyond them is an error. None: as many as
            turn out to be needed.
        **settings: As for :class:`LandingVectorEnv`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": round(CONTROL_RATE)}  # noqa: RUF012 - as above

    def __init__(
        self, render_mode: str | None = None, longest_episode: int | None = None, **settings: Any
    ) -> None:
        steps = FIRST_STEPS if longest_episode is None else longest_episode
        self._use(LandingVectorEnv(1, steps, render_mode=render_mode, **settings), longest_episode)
        self.render_mode = render_mode
