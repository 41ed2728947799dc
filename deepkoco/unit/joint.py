"""Motion of one joint with dry friction, in plain floats: Runge-Kutta with exact sticking."""

from __future__ import annotations

import math
from typing import NamedTuple

from deepkoco.unit.bodies import Body


class Friction(NamedTuple):
    """Resistance of the joint beyond the body's viscous term.

    The dry level is F(omega) = coulomb + breakaway exp(-(omega/speed)^2), against the motion.
    """

    coulomb: float = 0.0  # [N m], the body's own included
    breakaway: float = 0.0  # [N m]
    speed: float = 1.0  # [rad/s]
    quadratic: float = 0.0  # [N m s2/rad2]
    smoothing: float = 0.0  # width of the sign [rad/s]; 0 for a true sign, with sticking
    cogging: float = 0.0  # amplitude of a torque that follows the angle [N m]
    cogging_cycles: float = 0.0  # its cycles per turn


class Joint:
    """State of the joint and of its actuator, advanced in time.

    With a true sign of dry friction the motion is piecewise smooth: within a step the sign is fixed, a
    step in which the speed changes sign ends where it is zero, and there the joint sticks as long as
    the other torques stay within the friction level at standstill.

    Args:
        body: Mechanics.
        friction: Friction and cogging.
        lag: Time constant of the actuator [s], 0 for none.
        time_step: Longest integration step [s].
        theta: Angle [rad].
        omega: Speed [rad/s].
    """

    def __init__(
        self, body: Body, friction: Friction, lag: float, time_step: float, theta: float, omega: float
    ) -> None:
        self.theta = theta
        self.omega = omega
        self.effort = 0.0  # behind the lag, in the command's unit
        self._body = body
        self._friction = friction
        self._lag = lag
        self._step = time_step
        self._sticks = friction.smoothing == 0.0 and (friction.coulomb > 0.0 or friction.breakaway > 0.0)

    def advance(self, duration: float, drive: float, push: float) -> None:
        """Move on under a constant input.

        Args:
            duration: Time to cover [s].
            drive: What the actuator is told to deliver, in the command's unit.
            push: Outside torque [N m].
        """
        steps = max(1, math.ceil(duration / self._step - 1e-9))
        h = duration / steps
        decay = math.exp(-h / self._lag) if self._lag > 0.0 else 0.0
        half_decay = math.sqrt(decay)
        for _ in range(steps):
            excess = (self.effort if self._lag > 0.0 else drive) - drive
            begin, middle, end = drive + excess, drive + excess * half_decay, drive + excess * decay
            if self._sticks:
                self._move_or_stick(h, begin, middle, end, push)
            else:
                self._runge_kutta(h, begin, middle, end, push, 0.0)
            self.effort = end

    def _move_or_stick(self, h: float, begin: float, middle: float, end: float, push: float) -> None:
        # At most three phases fit into one step: slide to rest, stick or leave, slide on.
        for _ in range(3):
            if self.omega == 0.0:
                free = self._smooth_torque(self.theta, 0.0, begin, push)
                if abs(free) <= self._friction.coulomb + self._friction.breakaway:
                    return
                sign = math.copysign(1.0, free)
            else:
                sign = math.copysign(1.0, self.omega)
            theta, omega = self.theta, self.omega
            self._runge_kutta(h, begin, middle, end, push, sign)
            if self.omega * sign >= 0.0:
                return
            if omega == 0.0:  # turned back within its first step: it never really left
                self.theta, self.omega = theta, 0.0
                return
            until_rest = h * omega / (omega - self.omega)
            self.theta, self.omega = theta, omega
            self._runge_kutta(until_rest, begin, middle, end, push, sign)
            self.omega = 0.0
            h -= until_rest

    def _runge_kutta(
        self, h: float, begin: float, middle: float, end: float, push: float, sign: float
    ) -> None:
        theta, omega, half = self.theta, self.omega, 0.5 * h
        a1 = self._acceleration(theta, omega, begin, push, sign)
        v2 = omega + half * a1
        a2 = self._acceleration(theta + half * omega, v2, middle, push, sign)
        v3 = omega + half * a2
        a3 = self._acceleration(theta + half * v2, v3, middle, push, sign)
        v4 = omega + h * a3
        a4 = self._acceleration(theta + h * v3, v4, end, push, sign)
        self.theta = theta + h / 6.0 * (omega + 2.0 * v2 + 2.0 * v3 + v4)
        self.omega = omega + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)

    def _smooth_torque(self, theta: float, omega: float, effort: float, push: float) -> float:
        body = self._body
        torque = body.effort_gain * effort + body.gravity * math.sin(theta) - body.viscous * omega + push
        friction = self._friction
        if friction.quadratic:
            torque -= friction.quadratic * omega * abs(omega)
        if friction.cogging:
            torque += friction.cogging * math.sin(friction.cogging_cycles * theta)
        return torque

    def _acceleration(self, theta: float, omega: float, effort: float, push: float, sign: float) -> float:
        torque = self._smooth_torque(theta, omega, effort, push)
        friction = self._friction
        if friction.coulomb or friction.breakaway:
            level = friction.coulomb
            if friction.breakaway:
                level += friction.breakaway * math.exp(-((omega / friction.speed) ** 2))
            torque -= level * (math.tanh(omega / friction.smoothing) if friction.smoothing else sign)
        return torque / self._body.inertia
