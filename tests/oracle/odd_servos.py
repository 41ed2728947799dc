"""A position servo with an effect that is in no catalogue of causes: play in the gear, a weak supply and more."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from deepkoco.logs.recording import Recording, Series
from tests.oracle.servo_unit import FINE, GRAVITY, RATE, TICK, ServoUnit, goals_of

ODD = ("play", "warming", "sagging", "cable", "whip", "tight_spot")


@dataclass
class OddServo:
    """A unit of a bench with one odd effect.

    Attributes:
        unit: What the unit is otherwise.
        effect: One of ``ODD``; none if empty.
        size: Of the effect; 1 is about as large as a friction or a load that a user would notice.
    """

    unit: ServoUnit
    effect: str = ""
    size: float = 1.0
    _hidden: np.ndarray = field(default_factory=lambda: np.zeros(2), init=False)

    def log(self, motion: str, seed: int, seconds: float = 6.0, reach: float = 1.75) -> Recording:
        """A log like `tests.oracle.servo_unit.log_of`."""
        rng = np.random.default_rng(seed)
        goal_at, off = goals_of(motion, rng, seconds, reach)
        dt, zero = 1.0 / (RATE * FINE), self.unit.zero
        q = v = 0.0
        self._hidden = np.zeros(2)
        rows = []
        for k in range(int(seconds * RATE)):
            now = k / RATE
            goal, on = goal_at(now), 0.0 if off[0] <= now < off[1] else 1.0
            rows.append(
                (now, goal, on, TICK * np.round((q + zero + 0.3 * TICK * rng.standard_normal()) / TICK))
            )
            for _ in range(FINE):
                q, v = self._step(q, v, goal - zero, on, now / seconds, dt)
        t, goals, enabled, angles = np.array(rows).T
        return Recording(
            {
                "goal": Series(t, goals, "rad", "command"),
                "enable": Series(t, enabled, "1", "command"),
                "theta": Series(t, angles, "rad", "measurement"),
            },
        )

    def _step(
        self, q: float, v: float, goal: float, on: float, share: float, dt: float
    ) -> tuple[float, float]:
        u = self.unit
        weight = u.mass * GRAVITY * u.length
        asked = min(max(u.stiffness * (goal - q), -u.limit), u.limit)
        if self.effect == "sagging":
            # The supply's capacitor empties with the power that is drawn, and fills again in a third of a second.
            drawn = min(abs(asked) / weight, 1.0)
            self._hidden[0] += dt * (drawn - self._hidden[0]) / 0.3
            asked *= 1.0 / (1.0 + 0.4 * self.size * self._hidden[0])
        motor = on * (asked - u.damping * v)
        inertia, outside = u.armature, -u.viscous * v
        if self.effect in ("play", "whip"):
            outside += self._arm(q, v, weight, dt)
        else:
            inertia += u.mass * u.length**2
            outside -= weight * np.sin(q)
        level = u.dry + u.share * abs(0.5 * (motor - outside)) + u.excess * np.exp(-((v / 0.2) ** 2))
        if self.effect == "warming":
            level *= 1.0 + 1.5 * self.size * share**2
        if self.effect == "cable":
            # A cable wraps round the axis on one side and rubs there.
            level += 0.3 * self.size * weight * max(q - 0.1, 0.0) ** 2 / 0.3
        if self.effect == "tight_spot":
            level += 0.6 * self.size * weight * np.exp(-(((q - 0.25) / 0.08) ** 2))
        free = v + dt * (motor + outside) / inertia
        v = np.sign(free) * max(abs(free) - dt * level / inertia, 0.0)
        return q + dt * v, v

    def _arm(self, q: float, v: float, weight: float, dt: float) -> float:
        """Torque of the arm on the joint: behind an elastic stop with play, or on a whip that swings slowly."""
        u = self.unit
        inertia = u.mass * u.length**2
        play, stiff = (
            (0.03 * self.size, 60.0 * weight) if self.effect == "play" else (0.0, 12.0 * weight / self.size)
        )
        bend = self._hidden[0] - q
        pressed = np.sign(bend) * max(abs(bend) - play, 0.0)
        touch = 0.0 if play and not pressed else 0.1 * np.sqrt(stiff * inertia) * (self._hidden[1] - v)
        torque = stiff * pressed + touch
        self._hidden[1] += dt * (-weight * np.sin(self._hidden[0]) - torque) / inertia
        self._hidden[0] += dt * self._hidden[1]
        return torque
