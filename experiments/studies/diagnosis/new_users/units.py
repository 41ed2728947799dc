"""Equations of motion of the units, with what they hide; they share no code with the package.

Each function takes the parameters of a unit, hidden effects included, and returns the slope of its state: positions of
its joints, then their speeds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81
THIGH, OF_THIGH, OF_SHANK, FOOT = 0.25, 0.11, 0.10, 0.20  # length, centres of mass, place of a payload [m]

Values = Mapping[str, float]
Slope = Callable[[np.ndarray, np.ndarray], np.ndarray]


def cart(p: Values) -> Slope:
    """Return the slope of a cart with a hanging rod; the command is a force [N]."""
    whole, rod, length = p["cart_mass"] + p["pole_mass"], p["pole_mass"], p["length"]
    half = rod * length / 2.0

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        _, angle, speed, swing = x
        force = u[0] * p.get("gain", 1.0) - p["cart_viscous"] * speed - _dry(p, "coulomb", speed, 5e-4)
        force += half * swing * swing * np.sin(angle)
        torque = -half * GRAVITY * np.sin(angle) - p["pole_viscous"] * swing
        torque -= _dry(p, "pole_coulomb", swing, 0.01)
        matrix = [[whole, half * np.cos(angle)], [half * np.cos(angle), rod * length * length / 3.0]]
        return np.array([speed, swing, *np.linalg.solve(matrix, [force, torque])])

    return slope


def stiff(p: Values) -> Slope:
    """Return the slope of a motor with its load; the command is a voltage [V]."""
    inertia = p["motor_inertia"] + p["load_inertia"]

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        torque = _motor(p, u[0], x[1]) - p["viscous"] * x[1] - _dry(p, "coulomb", x[1], 0.02)
        return np.array([x[1], torque / inertia])

    return slope


def belt(p: Values) -> Slope:
    """Return the slope of the same motor with an elastic belt; friction acts on the load."""

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        angle, far, speed, far_speed = x
        pull = p["stiffness"] * (far - angle) + p["belt_damping"] * (far_speed - speed)
        load = -pull - p["viscous"] * far_speed - _dry(p, "coulomb", far_speed, 0.02)
        front = (_motor(p, u[0], speed) + pull) / p["motor_inertia"]
        return np.array([speed, far_speed, front, load / p["load_inertia"]])

    return slope


def crane(p: Values) -> Slope:
    """Return the slope of a trolley with a load on a cable; the command is a goal of the speed [m/s]."""
    whole, load, cable = p["trolley_mass"] + p["load_mass"], p["load_mass"], p["cable"]

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        _, angle, speed, swing = x
        force = p["drive_gain"] * (u[0] - speed) - _dry(p, "coulomb", speed, 3e-5)
        force += load * cable * swing * swing * np.sin(angle)
        torque = -load * cable * GRAVITY * np.sin(angle) - p["air"] * swing
        coupling = load * cable * np.cos(angle)
        matrix = [[whole, coupling], [coupling, load * cable * cable]]
        return np.array([speed, swing, *np.linalg.solve(matrix, [force, torque])])

    return slope


def axis(p: Values) -> Slope:
    """Return the slope of a table behind a cascade of controllers; the command is a goal [m]."""

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        force = p["kp"] * (p["kv"] * (u[0] - x[0]) - x[1]) - p["viscous"] * x[1]
        return np.array([x[1], (force - _dry(p, "coulomb", x[1], 2e-4)) / p["mass"]])

    return slope


def wheel(p: Values) -> Slope:
    """Return the slope of a pendulum with a reaction wheel; the command is a current [A]."""

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        angle, _, swing, spin = x
        torque = p["constant"] * u[0] * p.get("gain", 1.0) - p["wheel_viscous"] * spin
        torque -= _dry(p, "wheel_coulomb", spin, 0.05)
        body = -p["weight"] * np.sin(angle) - p["body_viscous"] * swing - torque
        body = (body - p.get("spring", 0.0) * angle) / p["body_inertia"]
        return np.array([swing, spin, body, torque / p["wheel_inertia"] - body])

    return slope


def cylinder(p: Values) -> Slope:
    """Return the slope of a hydraulic cylinder; the command is the voltage of its valve [V]."""

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        opened = np.sign(u[0]) * max(abs(u[0]) - p.get("dead_zone", 0.0), 0.0)
        opened *= 1.0 + p.get("asymmetry", 0.0) * np.sign(opened)
        return np.array([x[1], (p["flow_gain"] * opened - x[1]) / p["time_constant"]])

    return slope


def leg(p: Values) -> Slope:
    """Return the slope of a hanging leg with a spring at its knee; the commands are torques [N m]."""
    payload = p.get("payload", 0.0)
    moment = p["m2"] * OF_SHANK + payload * FOOT
    shank = p["I2"] + p["m2"] * OF_SHANK**2 + payload * FOOT**2
    thigh = p["I1"] + p["m1"] * OF_THIGH**2 + (p["m2"] + payload) * THIGH**2
    weight = p["m1"] * OF_THIGH + (p["m2"] + payload) * THIGH

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        hip, knee, turn, bend = x
        coupling, curve = moment * THIGH * np.cos(knee), moment * THIGH * np.sin(knee)
        far = GRAVITY * moment * np.sin(hip + knee)
        first = u[0] * p.get("hip_gain", 1.0) - p["b1"] * turn - GRAVITY * weight * np.sin(hip) - far
        first += curve * (2.0 * turn * bend + bend * bend)
        second = u[1] - p["b2"] * bend - _dry(p, "knee_coulomb", bend, 0.01)
        second -= p["stiffness"] * (knee - p["ref"]) + far + curve * turn * turn
        matrix = [[thigh + shank + 2.0 * coupling, shank + coupling], [shank + coupling, shank]]
        return np.array([turn, bend, *np.linalg.solve(matrix, [first, second])])

    return slope


def along(slope: Slope, start: np.ndarray, t: np.ndarray, commands: np.ndarray, delay: float) -> np.ndarray:
    """Return the states (n, S) at times (n,); a command (n, M) of a time acts from ``delay`` [s] after it."""
    changes = np.append(0, np.flatnonzero(np.any(np.diff(commands, axis=0) != 0.0, axis=1)) + 1)
    times, values = t[changes] + delay, commands[changes]
    acting = values[times <= 0.0][-1] if (times <= 0.0).any() else np.zeros(commands.shape[1])
    later = times > 0.0
    states = np.zeros((len(t), len(start)))
    x, now = np.array(start, dtype=float), 0.0
    states[t <= now] = x
    for stop, following in zip(np.append(times[later], np.inf), [*values[later], values[-1]], strict=True):
        end = min(stop, t[-1])
        if end > now:
            inside = (t > now) & (t <= end)
            at = np.unique(np.append(t[inside], end))
            found = solve_ivp(
                lambda _, y, u=acting: slope(y, u), (now, end), x, "LSODA", t_eval=at, rtol=1e-8, atol=1e-10
            )
            states[inside] = found.y[:, np.searchsorted(at, t[inside])].T
            x, now = found.y[:, -1], end
        if stop >= t[-1]:
            break
        acting = following
    return states


def behind_play(x: np.ndarray, width: float) -> np.ndarray:
    """Return the position (n,) behind a gear with play: it rests while the gear crosses the play."""
    result = np.empty_like(x)
    result[0] = x[0]
    for k in range(1, len(x)):
        result[k] = min(max(result[k - 1], x[k] - width / 2.0), x[k] + width / 2.0)
    return result


def _motor(p: Values, voltage: float, speed: float) -> float:
    return p["constant"] * (voltage - p["constant"] * speed) / p["resistance"]


def _dry(p: Values, name: str, speed: float, sharp: float) -> float:
    """Dry friction that grows over a speed ``sharp``; 0 where the unit has none."""
    return p.get(name, 0.0) * np.tanh(speed / sharp)
