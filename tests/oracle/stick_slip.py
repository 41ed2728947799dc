"""Logs from MuJoCo of robots whose joints stick: dry friction by MuJoCo's own constraint solver."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import torch
from torch import Tensor

from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import Channel, Motion, Parameter, Parameters, System, make_system
from deepkoco.systems.motion import Acceleration

GRAVITY = 9.81  # [m/s2]
STEP = 2e-4  # [s]
# MuJoCo's friction constraint is soft; with these its joints creep by less than 0.1 mrad/s while they stick.
TIGHT = 'solreffriction="0.0005 1" solimpfriction="0.999 0.9999 0.001"'
SENSOR_RATE, COMMAND_RATE = 100.0, 50.0  # [Hz]
MASS, VISCOUS = 0.8, 0.4  # of the slide [kg, N s/m]


class Slide(System):
    """M x'' = u - b x' on a level rail."""

    name = "slide"
    joints = 1
    state_names = ("position", "speed")
    state_units = ("m", "m/s")
    load_scale = 5.0

    def __init__(self) -> None:
        self.parameters = (
            Parameter("mass", MASS, "kg", 0.05, 20.0, 0.02, "M"),
            Parameter("viscous", VISCOUS, "N s/m", 0.0, 20.0, 0.05, "b"),
        )
        self.measurements = (
            Channel("position", "m", "measurement", noise_sd=1e-4),
            Channel("speed", "m/s", "measurement", noise_sd=0.01),
        )

    @property
    def commands(self) -> tuple[Channel, ...]:
        return (Channel("force", "N", "command", -5.0, 5.0),)

    def effort_of(self, commands: Tensor) -> Tensor:
        return commands[..., 0]

    def accelerations(self, parameters: Parameters) -> Acceleration:
        mass, viscous = parameters["mass"], parameters["viscous"]

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            force = motion.efforts[0] - viscous * motion.speeds[0]
            if motion.loads is not None and motion.loads[0] is not None:
                force = force + motion.loads[0]
            return (force / mass,)

        return acceleration

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        position, speed = state.unbind(-1)
        (rate,) = self.accelerations(parameters)(Motion((position,), (speed,), (effort,)))
        return torch.stack(torch.broadcast_tensors(speed, rate), -1)

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return {**parameters, "mass": parameters["mass"] + mass}

    def draw_on(self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None):
        raise NotImplementedError


def stick_slip_system(kind: str) -> System:
    """System of the same equations without dry friction: ``hinge``, ``slide`` or ``arm``."""
    names = {"hinge": "torque_pendulum", "arm": "two_link_arm"}
    return Slide() if kind == "slide" else make_system(names[kind])


def _bodies(kind: str, levels: Sequence[float], soft: str) -> str:
    value = {p.name: p.value for p in stick_slip_system(kind).parameters}
    losses = [f'frictionloss="{level}" {soft}' for level in levels]
    if kind == "slide":
        return f"""<body><joint name="j1" type="slide" axis="1 0 0" damping="{VISCOUS}" {losses[0]}/>
            <inertial pos="0 0 0" mass="{MASS}" diaginertia="1 1 1"/></body>"""
    if kind == "hinge":
        reach = 0.45
        mass = value["gravity_torque"] / GRAVITY / reach
        rest = value["inertia"] - mass * reach**2
        return f"""<body><joint name="j1" axis="0 -1 0" damping="{value["viscous"]}" {losses[0]}/>
            <inertial pos="0 0 -{reach}" mass="{mass}" diaginertia="{rest} {rest} {rest}"/></body>"""
    rods = []
    for k in (1, 2):
        mass, length = value[f"mass_{k}"], value[f"length_{k}"]
        own = mass * length**2 / 12.0
        rods.append(
            f"""<joint name="j{k}" axis="0 0 1" damping="{value[f"viscous_{k}"]}" {losses[k - 1]}/>
            <inertial pos="{0.5 * length} 0 0" mass="{mass}" diaginertia="1e-9 {own} {own}"/>"""
        )
    return f'<body>{rods[0]}<body pos="{value["length_1"]} 0 0">{rods[1]}</body></body>'


def stick_slip_model(kind: str, levels: Sequence[float], soft: str = TIGHT) -> mujoco.MjModel:
    """MuJoCo model with ``frictionloss`` ``levels`` [N m or N] at its joints."""
    motors = "".join(f'<motor joint="j{k + 1}"/>' for k in range(len(levels)))
    gravity = -GRAVITY if kind == "hinge" else 0.0
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{STEP}" gravity="0 0 {gravity}" integrator="implicit" iterations="100"
        tolerance="1e-12"/><worldbody>{_bodies(kind, levels, soft)}</worldbody>
        <actuator>{motors}</actuator></mujoco>"""
    )


def stick_slip_log(
    kind: str,
    levels: Sequence[float],
    seed: int,
    seconds: float = 20.0,
    noisy: bool = True,
    soft: str = TIGHT,
    reach: float = 2.0,
) -> Recording:
    """Log under random steps of up to ``reach`` times the friction, so that every joint sticks and slides.

    Args:
        kind: ``hinge``, ``slide`` or ``arm``.
        levels: Dry friction of each joint [N m or N].
        seed: Of the commands and of the noise.
        seconds: Length [s].
        noisy: Whether sensors have noise.
        soft: Attributes of the friction constraint.
        reach: Size of the largest command, in levels of friction.
    """
    system, model = stick_slip_system(kind), stick_slip_model(kind, levels, soft)
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    ticks, joints = round(seconds * COMMAND_RATE), len(levels)
    efforts = np.empty((ticks, joints))
    for j, level in enumerate(levels):
        held = rng.uniform(-reach * level, reach * level, ticks)
        efforts[:, j] = np.repeat(held, rng.integers(5, 30, ticks))[:ticks]
    shown = []
    per = round(1.0 / (SENSOR_RATE * STEP))
    for i in range(round(seconds * SENSOR_RATE)):
        shown.append(np.concatenate([data.qpos, data.qvel]))
        data.ctrl[:] = efforts[min(int(i * COMMAND_RATE / SENSOR_RATE + 1e-9), ticks - 1)]
        mujoco.mj_step(model, data, per)
    values = np.array(shown)
    if noisy:
        values += rng.standard_normal(values.shape) * [c.noise_sd for c in system.measurements]
    t, sent = np.arange(len(values)) / SENSOR_RATE, np.arange(ticks) / COMMAND_RATE
    channels = {
        c.name: Series(t, values[:, k], c.unit, "measurement") for k, c in enumerate(system.measurements)
    }
    for k, c in enumerate(system.commands):
        channels[c.name] = Series(sent, efforts[:, k], c.unit, "command")
    return Recording(channels, None, system.name, {})
