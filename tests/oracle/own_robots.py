"""Units of robots that are not in the package, written with scipy and sharing no code with it: a cart-pole, a motor.

A log is a CSV with one time column at 100 Hz, encoder steps and noise, and a sidecar, as a user would bring it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from scipy.integrate import solve_ivp

RATE = 100.0  # of the log [Hz]
GRAVITY = 9.81
SHARP = {"cart": 5e-4, "motor": 0.02}  # speed over which dry friction changes its sign [m/s, rad/s]


@dataclass(frozen=True)
class CartPoleUnit:
    """A cart-pole with what it hides.

    Attributes:
        cart_mass, pole_mass, length, cart_viscous, pole_viscous: In SI.
        coulomb: Dry friction of the cart [N].
        delay: From the logged command to the force [s].
        pull: Constant torque on the pole [N m].
    """

    cart_mass: float = 0.6
    pole_mass: float = 0.2
    length: float = 0.3
    cart_viscous: float = 0.5
    pole_viscous: float = 0.002
    coulomb: float = 0.0
    delay: float = 0.0
    pull: float = 0.0

    def log(self, folder: Path, name: str = "log", seed: int = 0, seconds: float = 20.0) -> Path:
        """Write a log under random force steps, and its sidecar."""
        rng = np.random.default_rng(seed)
        t = np.arange(round(seconds * RATE)) / RATE
        force = _steps(rng, t, 4.0)
        state = _integrate(self._slope, np.zeros(4), t, force, self.delay)
        position = _encoder(state[:, 0], 2e-5, 1e-4, rng)
        angle = _encoder(state[:, 1], 2e-4, 2.0 * np.pi / 8192, rng)
        columns = {"force": force, "position": position, "angle": angle}
        units = {"force": ("N", "command"), "position": ("m", "measurement"), "angle": ("rad", "measurement")}
        return _write(folder, name, t, columns, units)

    def _slope(self, x: np.ndarray, force: float) -> np.ndarray:
        _, angle, speed, swing = x
        mass, length = self.pole_mass, self.length
        pull = force - self.cart_viscous * speed - self.coulomb * np.tanh(speed / SHARP["cart"])
        matrix = np.array(
            [
                [self.cart_mass + mass, mass * length * np.cos(angle)],
                [mass * length * np.cos(angle), mass * length**2],
            ]
        )
        loads = [
            pull + mass * length * swing**2 * np.sin(angle),
            -mass * GRAVITY * length * np.sin(angle) - self.pole_viscous * swing + self.pull,
        ]
        return np.array([speed, swing, *np.linalg.solve(matrix, loads)])


@dataclass(frozen=True)
class MotorUnit:
    """A DC motor that turns a load by a belt; only its own encoder is read.

    Attributes:
        constant, resistance, motor_inertia, load_inertia, viscous: In SI.
        stiffness: Of the belt [N m/rad]; None for a belt that does not give.
        belt_damping: Of the belt [N m s/rad].
        coulomb: Dry friction [N m].
        delay: From the logged command to the voltage [s].
    """

    constant: float = 0.05
    resistance: float = 2.0
    motor_inertia: float = 5e-5
    load_inertia: float = 1.5e-4
    viscous: float = 1e-4
    stiffness: float | None = None
    belt_damping: float = 1e-3
    coulomb: float = 0.0
    delay: float = 0.0

    def log(
        self, folder: Path, name: str = "log", seed: int = 0, seconds: float = 20.0, jitter: float = 0.0
    ) -> Path:
        """Write a log under random voltage steps, and its sidecar; ``jitter`` [s] of the one clock."""
        rng = np.random.default_rng(seed)
        t = np.arange(round(seconds * RATE)) / RATE
        voltage = _steps(rng, t, 8.0)
        state = _integrate(self._slope, np.zeros(2 if self.stiffness is None else 4), t, voltage, self.delay)
        angle = _encoder(state[:, 0], 2e-4, 2.0 * np.pi / 8192, rng)
        stamps = np.sort(t + jitter * rng.standard_normal(len(t)))
        units = {"voltage": ("V", "command"), "angle": ("rad", "measurement")}
        return _write(folder, name, stamps, {"voltage": voltage, "angle": angle}, units)

    def _slope(self, x: np.ndarray, voltage: float) -> np.ndarray:
        if self.stiffness is None:
            speed = x[1]
            torque = (
                self.constant * (voltage - self.constant * speed) / self.resistance - self.viscous * speed
            )
            torque -= self.coulomb * np.tanh(speed / SHARP["motor"])
            return np.array([speed, torque / (self.motor_inertia + self.load_inertia)])
        angle, far, speed, far_speed = x
        belt = self.stiffness * (far - angle) + self.belt_damping * (far_speed - speed)
        torque = self.constant * (voltage - self.constant * speed) / self.resistance + belt
        torque -= self.coulomb * np.tanh(speed / SHARP["motor"])
        return np.array(
            [
                speed,
                far_speed,
                torque / self.motor_inertia,
                (-belt - self.viscous * far_speed) / self.load_inertia,
            ]
        )


def _steps(rng: np.random.Generator, t: np.ndarray, level: float) -> np.ndarray:
    """Random steps, each held for 0.1 to 0.5 s."""
    held = np.repeat(rng.uniform(-level, level, len(t)), rng.integers(10, 50, len(t)))
    return held[: len(t)]


def _integrate(slope, start: np.ndarray, t: np.ndarray, command: np.ndarray, delay: float) -> np.ndarray:
    """States at the stamps; the command of a stamp holds from ``delay`` after it until that of the next."""
    states = np.zeros((len(t), len(start)))
    switches = np.append(t[np.flatnonzero(np.diff(command)) + 1], np.inf) + delay
    values = command[np.append(0, np.flatnonzero(np.diff(command)) + 1)]
    x, now, k = start, t[0] + delay, 0  # at rest until the first command arrives
    while now < t[-1]:
        stop = min(switches[k], t[-1])
        inside = t[(t > now) & (t < stop)]
        found = solve_ivp(
            lambda _, y, u=values[k]: slope(y, u), (now, stop), x, "LSODA",
            t_eval=np.append(inside, stop), rtol=1e-9, atol=1e-11,
        )  # fmt: skip
        states[np.searchsorted(t, inside)] = found.y[:, :-1].T
        x, now = found.y[:, -1], stop
        at = np.searchsorted(t, stop)
        if at < len(t) and t[at] == stop:
            states[at] = x
        k += 1
    return states


def _encoder(value: np.ndarray, noise: float, step: float, rng: np.random.Generator) -> np.ndarray:
    return np.round((value + noise * rng.standard_normal(len(value))) / step) * step


def _write(
    folder: Path, name: str, t: np.ndarray, columns: dict[str, np.ndarray], units: dict[str, tuple[str, str]]
) -> Path:
    path = folder / f"{name}.csv"
    rows = np.column_stack([t, *columns.values()])
    np.savetxt(path, rows, delimiter=",", header=",".join(["t", *columns]), comments="", fmt="%.9g")
    channels = {
        n: {"column": n, "unit": unit, "kind": kind, "checked": True} for n, (unit, kind) in units.items()
    }
    sidecar = {"time": {"column": "t", "unit": "s"}, "channels": channels}
    path.with_suffix(".yaml").write_text(yaml.safe_dump(sidecar))
    return path
