r"""A controller for landings that is made by hand: polynomials that end on the deck in its attitude.

With the time to go s, each axis of the way from the deck is a polynomial that ends at the centre, with a sink speed
along the normal and the acceleration that a thrust along the normal gives:

    q(s) = - v_T s + a_T s^2 / 2 + b s^3 + d s^4 + e s^5

b, d and e follow from place, velocity and acceleration, anew at each tick. Thrust and attitude are sent ahead by their
lags times the jerk of the polynomial, so that they follow it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from deepkoco.envs.landing.seat import CENTRE, SCALE

TICK, STEP = 0.02, 0.005  # of decisions, and of the prediction [s]
EARTH = 9.81  # [m/s2]
FLIGHT, AGAIN = 1.6, 1.2  # time to go at the start, and after the plane was missed [s]
SINK = 0.55  # wanted at the touch-down [m/s]
DOWN = 1.5  # further acceleration towards the deck at the end, so that it is reached [m/s2]
TURNING = 0.08  # time in which the attitude of the deck is taken on at the end [s]
END = 0.16  # below this time to go the attitude is that of the deck [s]
STEEPEST = 0.5  # [rad]


class GuidedLanding:
    """Lands along polynomials; an object is for one flight of B bodies.

    Args:
        values: Parameters of the body, as identified; and the delays of its commands, as far as it knows them.
        late: Delay of the measured deck, as far as it knows it [s].
    """

    def __init__(self, values: Mapping[str, float], late: float) -> None:
        v = values
        self.values, self.late = values, late
        self._lags = np.array([v["motor_lag"], v["roll_lag"], v["pitch_lag"]])
        self._gains = np.array([1.0, v["roll_gain"], v["pitch_gain"]])
        self._delays = np.array([v["thrust_delay"], v["roll_delay"], v["pitch_delay"]])
        self._ahead = float(self._delays[1:].mean())
        hover = np.array([v["mass"] * EARTH, 0.0, 0.0])
        self._time, self._to_go = 0.0, np.zeros(0)
        self._sent: deque[tuple[float, np.ndarray]] = deque([(-np.inf, hover)], maxlen=20)
        self._acting = hover

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions (B, 3) for observations (B, N) of `LandingSeat`."""
        way, closing = observations[:, :3].copy(), observations[:, 3:6].copy()
        level = observations[:, 6:8]
        normal = np.concatenate([level, np.sqrt(1.0 - np.minimum((level**2).sum(1, keepdims=True), 0.9))], 1)
        way[:, :2] -= self.late * observations[:, 8:10]  # the deck has gone on since
        if self._to_go.size == 0:
            self._to_go = np.full(len(way), FLIGHT)
            self._acting = np.tile(self._acting, (len(way), 1))
        way, closing, acting = self._predicted(way, closing)
        command = self._guided(way, closing, normal, acting)
        self._sent.append((self._time, command))
        for _ in range(round(TICK / STEP)):
            self._acting = self._answer(self._acting, self._time)
            self._time += STEP
        self._to_go = self._to_go - TICK
        missed = self._to_go - self._ahead < -END
        self._to_go = np.where(missed, AGAIN, self._to_go)
        return (command - CENTRE) / SCALE

    def _guided(
        self, way: np.ndarray, closing: np.ndarray, normal: np.ndarray, acting: np.ndarray
    ) -> np.ndarray:
        """Commands (B, 3) for the way and the velocity at the time at which they act."""
        to_go = np.maximum(self._to_go - self._ahead, END)[:, None]
        end_speed = -SINK * normal
        gravity = np.array([0.0, 0.0, EARTH])
        # Along the deck only, so that the sink speed stays.
        end_pull = EARTH * normal[:, 2:] * normal - gravity
        pull = self._pull(acting)
        place = way + end_speed * to_go - 0.5 * end_pull * to_go**2
        speed = (-closing + end_speed - end_pull * to_go) * to_go
        bend = (pull - end_pull) * to_go**2
        fifth = 0.5 * bend - 3.0 * speed + 6.0 * place
        fourth = speed - 3.0 * place - 2.0 * fifth
        third = place - fourth - fifth
        jerk = -(6.0 * third + 24.0 * fourth + 60.0 * fifth) / to_go**3
        ends = self._to_go[:, None] - self._ahead < END
        jerk = np.where(ends, (end_pull - DOWN * normal - pull) / TURNING, jerk)
        pull = pull + gravity
        mass = self.values["mass"]
        thrust = mass * np.linalg.norm(pull + self._lags[0] * jerk, axis=1)
        x, y, z = (pull + self._lags[1:].mean() * jerk).T
        size = np.sqrt(x * x + y * y + z * z)
        roll, pitch = -np.arcsin(np.clip(y / size, -1.0, 1.0)), np.arctan2(x, np.maximum(z, 1.0))
        command = np.stack([thrust, roll, pitch], 1) / self._gains
        command[:, 0] = np.clip(command[:, 0], 0.0, 2.0 * CENTRE[0])
        command[:, 1:] = np.clip(command[:, 1:], -STEEPEST, STEEPEST)
        return command

    def _predicted(self, way: np.ndarray, closing: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Way, velocity and what acts, when a command of now begins to act; the deck keeps its velocity."""
        acting, time = self._acting, self._time
        for _ in range(round(self._ahead / STEP)):
            acting = self._answer(acting, time)
            time += STEP
            pull = self._pull(acting)
            way, closing = way + STEP * closing + 0.5 * STEP**2 * pull, closing + STEP * pull
        return way, closing, acting

    def _pull(self, acting: np.ndarray) -> np.ndarray:
        """Acceleration (B, 3) under the thrust and attitude that act, without drag."""
        thrust, roll, pitch = (acting * self._gains).T
        axis = np.stack([np.cos(roll) * np.sin(pitch), -np.sin(roll), np.cos(roll) * np.cos(pitch)], 1)
        return axis * (thrust / self.values["mass"])[:, None] - [0.0, 0.0, EARTH]

    def _answer(self, acting: np.ndarray, time: float) -> np.ndarray:
        """What acts a step later, of the commands that have come by then."""
        target = np.empty_like(acting)
        for index, delay in enumerate(self._delays):
            newest = next(c for t, c in reversed(self._sent) if t <= time - delay + 1e-9 or t == -np.inf)
            target[:, index] = newest[..., index]
        return target + (acting - target) * np.exp(-STEP / self._lags)
