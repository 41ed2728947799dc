"""A cart-pole as a user would declare it, and an independent simulation of it with dry friction on the cart."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from deepkoco.logs.recording import Recording, Series
from deepkoco.systems.channel import Channel
from deepkoco.systems.motion import Acceleration, Motion
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System

GRAVITY = 9.81
CART_MASS, POLE_MASS, LENGTH, CART_VISCOUS, POLE_VISCOUS = 0.6, 0.2, 0.3, 0.5, 0.002
RATE = 100.0  # of the sensors [Hz]
STEP = 2e-4  # of the independent simulation [s]
SHARP = 2e-4  # speed over which its dry friction changes sign [m/s]
CART_QUANTUM, POLE_QUANTUM = 1e-4, 2.0 * math.pi / 8192  # of the encoders [m, rad]


class CartPole(System):
    """A cart on a rail with a point mass on a hanging rod; q = (position, angle from below)."""

    name = "cart_pole"
    joints = 2
    state_names = ("position", "angle", "cart_speed", "pole_speed")
    state_units = ("m", "rad", "m/s", "rad/s")

    def __init__(self) -> None:
        self.parameters = (
            Parameter("cart_mass", CART_MASS, "kg", 0.05, 5.0, 0.02, "M"),
            Parameter("pole_mass", POLE_MASS, "kg", 0.01, 2.0, 0.01, "m"),
            Parameter("length", LENGTH, "m", 0.05, 2.0, 0.005, "l"),
            Parameter("cart_viscous", CART_VISCOUS, "N s/m", 0.0, 10.0, 0.1, "b"),
            Parameter("pole_viscous", POLE_VISCOUS, "N m s/rad", 0.0, 1.0, 0.001, "c"),
        )
        self.measurements = (
            Channel("position", "m", "measurement", noise_sd=1e-4, description="cart"),
            Channel("angle", "rad", "measurement", noise_sd=1e-3, description="pole", angle=True),
        )

    @property
    def commands(self) -> tuple[Channel, ...]:
        return (Channel("force", "N", "command", -10.0, 10.0, description="force on the cart"),)

    def effort_of(self, commands: Tensor) -> Tensor:
        return commands[..., 0]

    @property
    def joint_names(self) -> tuple[str, ...]:
        return "cart", "pole"

    @property
    def command_joints(self) -> tuple[int, ...]:
        return (0,)

    @property
    def measured_states(self) -> tuple[int, ...]:
        return (0, 1)

    def ideal_measurement(self, state: Tensor) -> Tensor:
        return state[..., :2]

    @property
    def load_scale(self) -> float:
        return 10.0

    @property
    def load_scales(self) -> tuple[float, ...]:
        return 10.0, POLE_MASS * GRAVITY * LENGTH

    def accelerations(self, parameters: Parameters) -> Acceleration:
        cart, pole, length = parameters["cart_mass"], parameters["pole_mass"], parameters["length"]
        viscous, pivot = parameters["cart_viscous"], parameters["pole_viscous"]

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            (_, angle), (speed, swing) = motion.angles, motion.speeds
            sine, cosine = torch.sin(angle), torch.cos(angle)
            force = motion.efforts[0] - viscous * speed + pole * length * swing**2 * sine
            torque = -pole * GRAVITY * length * sine - pivot * swing
            if motion.loads is not None:
                force = force if motion.loads[0] is None else force + motion.loads[0]
                torque = torque if motion.loads[1] is None else torque + motion.loads[1]
            m11, m12, m22 = cart + pole, pole * length * cosine, pole * length**2
            determinant = m11 * m22 - m12 * m12
            return (m22 * force - m12 * torque) / determinant, (m11 * torque - m12 * force) / determinant

        return acceleration

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        position, angle, speed, swing = state.unbind(-1)
        accelerations = self.accelerations(parameters)(Motion((position, angle), (speed, swing), (effort,)))
        return torch.stack(torch.broadcast_tensors(speed, swing, *accelerations), -1)

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return {**parameters, "pole_mass": parameters["pole_mass"] + mass}

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        raise NotImplementedError


@lru_cache
def cart_pole_log(
    coulomb: float = 0.0, seed: int = 0, seconds: float = 20.0, level: float = 4.0
) -> Recording:
    """A log of two encoders under random force steps.

    Args:
        coulomb: Dry friction of the cart [N].
        seed: Of the forces and the noise.
        seconds: Length [s].
        level: Largest force [N].
    """
    rng = np.random.default_rng(seed)
    sent, force = _forces(rng, seconds, level)
    count = round(seconds * RATE)
    per = round(1.0 / (RATE * STEP))
    x, rows, k = (0.0, 0.0, 0.0, 0.0), [], 0
    for i in range(count * per):
        if i % per == 0:
            rows.append(x[:2])
        t = i * STEP
        while k + 1 < len(sent) and sent[k + 1] <= t + 1e-9:
            k += 1
        x = _step(x, float(force[k]), coulomb)
    shown = np.array(rows) + rng.standard_normal((count, 2)) * [2e-5, 2e-4]
    shown = np.round(shown / [CART_QUANTUM, POLE_QUANTUM]) * [CART_QUANTUM, POLE_QUANTUM]
    t = np.arange(count) / RATE
    return Recording(
        {
            "position": Series(t, shown[:, 0], "m", "measurement"),
            "angle": Series(t, shown[:, 1], "rad", "measurement"),
            "force": Series(sent, force, "N", "command"),
        },
        system="cart_pole",
    )


def _forces(rng: np.random.Generator, seconds: float, level: float) -> tuple[np.ndarray, np.ndarray]:
    sent = np.arange(round(seconds / 0.02)) * 0.02
    held = np.repeat(rng.uniform(-level, level, len(sent)), rng.integers(5, 25, len(sent)))
    return sent, held[: len(sent)]


def _slope(x: tuple[float, ...], force: float, coulomb: float) -> tuple[float, ...]:
    _, angle, speed, swing = x
    sine, cosine = math.sin(angle), math.cos(angle)
    pull = force - CART_VISCOUS * speed - coulomb * math.tanh(speed / SHARP)
    pull += POLE_MASS * LENGTH * swing**2 * sine
    torque = -POLE_MASS * GRAVITY * LENGTH * sine - POLE_VISCOUS * swing
    m11, m12, m22 = CART_MASS + POLE_MASS, POLE_MASS * LENGTH * cosine, POLE_MASS * LENGTH**2
    determinant = m11 * m22 - m12 * m12
    return speed, swing, (m22 * pull - m12 * torque) / determinant, (m11 * torque - m12 * pull) / determinant


def _step(x: tuple[float, ...], force: float, coulomb: float) -> tuple[float, ...]:
    """One Runge-Kutta step."""

    def moved(slope: tuple[float, ...], h: float) -> tuple[float, ...]:
        return tuple(a + h * b for a, b in zip(x, slope, strict=True))

    k1 = _slope(x, force, coulomb)
    k2 = _slope(moved(k1, 0.5 * STEP), force, coulomb)
    k3 = _slope(moved(k2, 0.5 * STEP), force, coulomb)
    k4 = _slope(moved(k3, STEP), force, coulomb)
    mean = tuple((a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
    return moved(mean, STEP)
