"""Quadrotors that share no code with the simulator, several at once: motion, lags, delays with jitter.

The motion is integrated in steps of 1 ms; every command has the delay of its kind and a jitter of its own, and never
overtakes the one before.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

STEP, TICK = 1e-3, 20  # [s], steps between two commands
EARTH = 9.81  # [m/s2]
NOISE = np.repeat((0.002, 0.02), 3)  # of places [m] and velocities [m/s]
JITTER = 1e-3  # standard deviation of a delay [s]


class QuadrotorFlight:
    """B quadrotors of the same hidden parameters, held by the thrust that their masses need.

    Args:
        true: Parameters and delays, by the names of the system `quadrotor`.
        start: (B, 6) places [m] and velocities [m/s].
        further_delay: Added to each of the delays of the commands [s].
        rng: Of jitter and noise.
        jitter: Standard deviation of a delay [s].
    """

    def __init__(
        self,
        true: Mapping[str, float],
        start: np.ndarray,
        further_delay: float,
        rng: np.random.Generator,
        jitter: float = JITTER,
    ) -> None:
        p = true
        self.true, self.state, self._rng, self._jitter = true, np.array(start, float), rng, jitter
        self.steps = 0
        self._lags = np.array([p["motor_lag"], p["roll_lag"], p["pitch_lag"]])
        self._delays = np.array([p["thrust_delay"], p["roll_delay"], p["pitch_delay"]]) + further_delay
        held = np.array([p["mass"] * EARTH, 0.0, 0.0])
        self._acting = np.tile(held, (len(start), 1))
        self._target = self._acting.copy()
        self._under_way: list[tuple[np.ndarray, np.ndarray]] = []
        self._last = np.full((len(start), 3), -np.inf)

    @property
    def time(self) -> float:
        """Since the start [s]."""
        return self.steps * STEP

    @property
    def axis(self) -> np.ndarray:
        """Unit vectors (B, 3) along which they push."""
        roll, pitch = (
            self.true["roll_gain"] * self._acting[:, 1],
            self.true["pitch_gain"] * self._acting[:, 2],
        )
        return _axis(roll, pitch)

    def send(self, command: np.ndarray) -> None:
        """Send commands (B, 3): thrust [N], roll and pitch [rad]."""
        jitter = self._rng.normal(0.0, self._jitter, command.shape)
        due = np.maximum(self.time + np.maximum(self._delays + jitter, 0.0), self._last)
        self._last = due
        self._under_way.append((due, command))

    def advance(self) -> None:
        """One step: the middle of it is exact for held targets, and of second order for the motion."""
        middle = (self.steps + 0.5) * STEP
        for due, command in self._under_way:
            self._target = np.where(due <= middle, command, self._target)
        if len(self._under_way) > 1 and (self._under_way[1][0] <= middle).all():
            self._under_way.pop(0)
        way = self._acting - self._target
        half = self._target + way * np.exp(-0.5 * STEP / self._lags)
        between = self.state + 0.5 * STEP * self._slope(self.state, self._acting)
        self.state = self.state + STEP * self._slope(between, half)
        self._acting = self._target + way * np.exp(-STEP / self._lags)
        self.steps += 1

    def measured(self) -> np.ndarray:
        """Places and velocities (B, 6) with noise."""
        return self.state + NOISE * self._rng.standard_normal(self.state.shape)

    def _slope(self, state: np.ndarray, acting: np.ndarray) -> np.ndarray:
        p, thrust = self.true, acting[:, 0]
        push = thrust[:, None] * _axis(p["roll_gain"] * acting[:, 1], p["pitch_gain"] * acting[:, 2])
        drag = np.array([p["drag"], p["drag"], p["drag_up"]]) * state[:, 3:]
        return np.concatenate([state[:, 3:], (push - drag) / p["mass"] - [0.0, 0.0, EARTH]], 1)


def _axis(roll: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(roll) * np.sin(pitch), -np.sin(roll), np.cos(roll) * np.cos(pitch)], 1)
