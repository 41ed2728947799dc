"""Units of the study of landings: hidden quadrotors over decks that share no code with the simulator, several at once.

Body and deck move in steps of 1 ms, and a touch-down is found at one of them. The measured deck is late by a delay of
its own; what is seen is the newest that has come.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from deepkoco.envs.landing.seat import BOUNDS, CENTRE, FAR, HIGH, SCALE, observed
from deepkoco.systems.landing import DECK_RADIUS, GROUND, LIMITS
from experiments.studies.learning.quadrotor_flight import STEP, TICK, QuadrotorFlight

SENSOR = 10  # steps between two measurements of the deck
DECK_NOISE = np.repeat((0.005, 0.02, 0.01), 3)  # place [m], velocity [m/s], components of the normal
TURN_SPREAD, TURN_TIME = 0.4, 1.0  # of the turn rate of a deck [rad/s], and over which it is forgotten [s]
LATENESS = 0.005  # spread of the delays of single measurements [s]
FLIGHT_STEPS = 200
ALTITUDES, AROUND, FIRST_SPEED = (0.4, 1.0), 0.7, 0.5  # of the start over the deck and beside it [m], [m/s]


class LandingUnits(VectorEnv):
    """B quadrotors of the same hidden parameters, each over a deck of its own, as an environment of the task.

    Observations and actions are those of `LandingVectorEnv`. ``info`` has, (B,) each, ``touched``, ``success``,
    ``offset``, ``sink``, ``slip`` and ``tilt`` of the first touch-down, ``lost`` (on the ground or out of the room),
    and ``place``, ``deck``, ``normal`` and ``axis`` (B, 3). What follows a touch-down has no meaning.

    Args:
        true: Parameters and delays of the units, by the names of the system `quadrotor`.
        incline: (B,) of the decks [rad].
        speed: (B,) of the decks [m/s].
        deck_delay: Mean delay of the measured deck [s].
        action_history: Past actions that are seen.
    """

    metadata = {"render_modes": [], "render_fps": 50, "autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012

    def __init__(
        self,
        true: Mapping[str, float],
        incline: np.ndarray,
        speed: np.ndarray,
        deck_delay: float,
        action_history: int,
    ) -> None:
        self.num_envs, self.true = len(incline), true
        self._incline, self._speed, self._deck_delay = np.array(incline), np.array(speed), deck_delay
        bound = np.concatenate([BOUNDS, np.ones(3 * action_history)]).astype(np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)
        self.single_observation_space = spaces.Box(-bound, bound, dtype=np.float32)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._history = np.zeros((self.num_envs, action_history, 3))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):  # pyright: ignore[reportIncompatibleMethodOverride]
        """Start in the air near the decks; the seed is that of starts, decks, noise and jitter."""
        self._rng = rng = np.random.default_rng(seed)
        count = self.num_envs
        start = np.concatenate(
            [
                rng.uniform(-AROUND, AROUND, (count, 2)),
                rng.uniform(*ALTITUDES, (count, 1)),
                rng.uniform(-FIRST_SPEED, FIRST_SPEED, (count, 3)),
            ],
            1,
        )
        self._heading, self._slope = rng.uniform(0.0, 2.0 * np.pi, (2, count))
        self._turn = TURN_SPREAD * rng.standard_normal(count)
        self._deck = np.zeros((count, 3))
        self._flight = QuadrotorFlight(self.true, start, 0.0, rng)
        self._touch = {name: np.zeros(count) for name in ("touched", "offset", "sink", "slip", "tilt")}
        self._lost = np.zeros(count, bool)
        self._seen = self._measured_deck(noise=False)
        self._coming: deque[tuple[np.ndarray, np.ndarray]] = deque()
        self._height = self._against()[0]
        self._history[:] = 0.0
        if self._history.shape[1]:
            hover = np.array([0.033 * 9.81, 0.0, 0.0])
            self._history[:, 0] = (hover - CENTRE) / SCALE
        return self._shown(), self._info()

    def step(self, actions: np.ndarray):
        """Send the actions (B, 3) and go on to the next tick."""
        actions = np.clip(np.asarray(actions, float), -1.0, 1.0)
        command = actions * SCALE + CENTRE
        stopped = (self._touch["touched"] > 0.5) | self._lost
        command[stopped, 0] = 0.0
        self._flight.send(command)
        for _ in range(TICK):
            self._advance()
        if self._history.shape[1]:
            self._history = np.concatenate([actions[:, None], self._history[:, :-1]], 1)
        info = self._info()
        ended = (info["touched"] > 0.5) | info["lost"]
        return self._shown(), -info["distance"], ended, np.zeros(self.num_envs, bool), info

    def _advance(self) -> None:
        if self._flight.steps % SENSOR == 0:
            late = np.maximum(self._deck_delay + LATENESS * self._rng.uniform(-1.0, 1.0, self.num_envs), 0.0)
            self._coming.append((self._flight.time + late, self._measured_deck()))
        self._flight.advance()
        rate = np.exp(-STEP / TURN_TIME)
        self._heading = self._heading + STEP * self._turn
        way = np.stack([np.cos(self._heading), np.sin(self._heading)], 1)
        self._deck[:, :2] += STEP * self._speed[:, None] * way
        kick = self._rng.standard_normal(self.num_envs)
        self._turn = rate * self._turn + TURN_SPREAD * np.sqrt(1.0 - rate * rate) * kick
        height, offset, sink, slip, tilt = self._against()
        meets = (
            (height * self._height <= 0.0)
            & (offset <= DECK_RADIUS)
            & (self._touch["touched"] < 0.5)
            & ~self._lost
        )
        for name, value in zip(self._touch, (1.0, offset, sink, slip, tilt), strict=True):
            self._touch[name] = np.where(meets, value, self._touch[name])
        self._height = height
        relative = self._flight.state[:, :3] - self._deck
        gone = (np.abs(relative[:, :2]).max(1) > FAR) | (relative[:, 2] > HIGH) | (relative[:, 2] < GROUND)
        self._lost |= gone & (self._touch["touched"] < 0.5)

    def _normal(self) -> np.ndarray:
        direction, incline = self._heading + self._slope, self._incline
        return np.stack(
            [np.sin(incline) * np.cos(direction), np.sin(incline) * np.sin(direction), np.cos(incline)], 1
        )

    def _against(self) -> tuple[np.ndarray, ...]:
        """Height, offset [m], sink speed, slip speed [m/s] and tilt [rad] of the bodies against their decks."""
        way, normal = self._flight.state[:, :3] - self._deck, self._normal()
        velocity = self._deck_velocity() + np.cross(np.array([0.0, 0.0, 1.0]) * self._turn[:, None], way)
        closing = self._flight.state[:, 3:] - velocity
        height, rising = np.einsum("bi,bi->b", way, normal), np.einsum("bi,bi->b", closing, normal)
        tilt = np.arccos(np.clip(np.einsum("bi,bi->b", self._flight.axis, normal), -1.0, 1.0))
        offset = np.linalg.norm(way - height[:, None] * normal, axis=1)
        slip = np.linalg.norm(closing - rising[:, None] * normal, axis=1)
        return height, offset, -rising, slip, tilt

    def _deck_velocity(self) -> np.ndarray:
        level = np.zeros(self.num_envs)
        return self._speed[:, None] * np.stack([np.cos(self._heading), np.sin(self._heading), level], 1)

    def _measured_deck(self, noise: bool = True) -> np.ndarray:
        exact = np.concatenate([self._deck, self._deck_velocity(), self._normal()], 1)
        return exact + (DECK_NOISE * self._rng.standard_normal(exact.shape) if noise else 0.0)

    def _shown(self) -> np.ndarray:
        now = self._flight.time
        for due, measured in self._coming:
            self._seen = np.where((due <= now)[:, None], measured, self._seen)
        while self._coming and (self._coming[0][0] <= now).all():
            self._coming.popleft()
        body, deck = torch.from_numpy(self._flight.measured()), torch.from_numpy(self._seen)
        own = observed(body, deck[:, :3], deck[:, 3:6], deck[:, 6:]).numpy()
        return np.concatenate([own, self._history.reshape(self.num_envs, -1)], 1).astype(np.float32)

    def _info(self) -> dict[str, Any]:
        touch = self._touch
        success = (
            (touch["touched"] > 0.5)
            & (touch["offset"] <= LIMITS.offset)
            & (touch["sink"] >= 0.0)
            & (touch["sink"] <= LIMITS.sink)
            & (touch["slip"] <= LIMITS.slip)
            & (touch["tilt"] <= LIMITS.tilt)
        )
        place = self._flight.state[:, :3]
        return {
            **{name: value.copy() for name, value in touch.items()},
            "success": success,
            "lost": self._lost.copy(),
            "distance": np.linalg.norm(place - self._deck, axis=1),
            "place": place.copy(),
            "deck": self._deck.copy(),
            "normal": self._normal(),
            "axis": self._flight.axis,
        }
