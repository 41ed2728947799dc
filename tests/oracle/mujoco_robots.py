"""Robots that nobody wrote by hand: random arms and a cart-pole as MJCF text, the way a user has them in a file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

Drive = Literal["motor", "position"]
AXES = ("0 1 0", "0 0 1", "1 0 0")


@dataclass(frozen=True)
class Robot:
    """A model as a user has it in a file.

    Attributes:
        name: Name of the model.
        xml: MJCF of the model.
        drive: Kind of its actuators.
        sizes: Largest command of each actuator: torque [N m], force [N], or goal [rad or m].
    """

    name: str
    xml: str
    drive: Drive
    sizes: tuple[float, ...]


def random_arm(rng: np.random.Generator, joints: int, drive: Drive) -> Robot:
    """Draw an arm on a base: links get lighter and shorter to the tip, and so do armature, friction and actuators.

    Args:
        rng: Generator of everything that is drawn.
        joints: Number of hinges.
        drive: Kind of the actuators, one at each joint.
    """
    # The first axis is often vertical. Later axes alternate, so that gravity loads most joints.
    axes = [AXES[1] if rng.random() < 0.6 else AXES[0]]
    axes += [AXES[int(rng.choice([0, 0, 0, 1, 2]))] for _ in range(joints - 1)]
    axes[1] = AXES[0]
    length = rng.uniform(0.15, 0.35, joints) * 0.85 ** np.arange(joints)
    mass = rng.uniform(0.4, 1.2, joints) * 0.7 ** np.arange(joints)
    weight = _weights(mass, length)
    lines, closing, motors, sizes = [], [], [], []
    for j in range(joints):
        where = "0 0 0.1" if j == 0 else f"{length[j - 1]:.4f} 0 0"
        # A torque at which the joint feels gravity, or the inertia of what it carries where gravity does not load it.
        load = 9.81 * weight[j]
        radius = rng.uniform(0.015, 0.03)
        along = length[j] * rng.uniform(0.4, 0.6)
        slender, thick = mass[j] * length[j] ** 2 / 12.0, mass[j] * radius**2
        pad = "  " * (j + 2)
        lines.append(f'{pad}<body name="link{j + 1}" pos="{where}">')
        damping, rubs = rng.uniform(0.03, 0.08) * load, rng.uniform(0.01, 0.04) * load
        rotor = rng.uniform(0.005, 0.02) * load / 9.81
        lines.append(
            f'{pad}  <joint name="j{j + 1}" type="hinge" axis="{axes[j]}" damping="{damping:.5f}" '
            f'frictionloss="{rubs:.5f}" armature="{rotor:.6f}"/>'
        )
        lines.append(
            f'{pad}  <inertial pos="{along:.4f} {rng.uniform(-0.01, 0.01):.4f} {rng.uniform(-0.01, 0.01):.4f}" '
            f'mass="{mass[j]:.4f}" diaginertia="{thick:.7f} {slender + thick:.7f} {slender + thick:.7f}"/>'
        )
        closing.append(f"{pad}</body>")
        if drive == "motor":
            limit = 2.5 * load
            motors.append(
                f'    <motor name="m{j + 1}" joint="j{j + 1}" ctrlrange="{-limit:.4f} {limit:.4f}"/>'
            )
            sizes.append(limit)
        else:
            inertia = weight[j] * (length[j] + 0.1)
            bandwidth = rng.uniform(14.0, 25.0)
            kp, kv = inertia * bandwidth**2, 1.4 * inertia * bandwidth
            limit = 1.4
            motors.append(
                f'    <position name="m{j + 1}" joint="j{j + 1}" kp="{kp:.4f}" kv="{kv:.5f}" '
                f'ctrlrange="-3 3" forcerange="{-4.0 * load:.4f} {4.0 * load:.4f}"/>'
            )
            sizes.append(limit)
    name = f"arm{joints}_{drive}"
    body = "\n".join([*lines, *reversed(closing)])
    return Robot(name, _model(name, body, motors), drive, tuple(round(float(s), 4) for s in sizes))


def cart_pole(rng: np.random.Generator) -> Robot:
    """Draw a cart on a rail with a hanging pole and a motor on the cart."""
    cart, pole, length = rng.uniform(0.4, 1.0), rng.uniform(0.08, 0.3), rng.uniform(0.3, 0.6)
    inertia = pole * length**2 / 12.0
    damping, rubs, pivot = rng.uniform(0.2, 0.8), rng.uniform(0.05, 0.3), rng.uniform(0.0005, 0.002)
    body = f"""    <body name="cart">
      <joint name="slider" type="slide" axis="1 0 0" damping="{damping:.4f}" frictionloss="{rubs:.4f}"/>
      <inertial pos="0 0 0" mass="{cart:.4f}" diaginertia="0.001 0.001 0.001"/>
      <body name="pole">
        <joint name="pivot" type="hinge" axis="0 1 0" damping="{pivot:.5f}"/>
        <inertial pos="0 0 {-0.5 * length:.4f}" mass="{pole:.4f}" diaginertia="{inertia:.6f} {inertia:.6f} 0.00001"/>
      </body>
    </body>"""
    motors = ['    <motor name="force" joint="slider" ctrlrange="-10 10"/>']
    return Robot("cart_pole", _model("cart_pole", body, motors), "motor", (10.0,))


def pendulum(rng: np.random.Generator, drive: Drive) -> Robot:
    """Draw one link on a horizontal axis, with a motor or a servo."""
    length, mass = rng.uniform(0.2, 0.5), rng.uniform(0.3, 1.5)
    load, slender = 9.81 * mass * 0.5 * length, mass * length**2 / 12.0
    inertia = mass * length**2 / 3.0
    damping, rubs = rng.uniform(0.02, 0.06) * load, rng.uniform(0.01, 0.03) * load
    rotor = rng.uniform(0.02, 0.08) * inertia
    body = f"""    <body name="link" pos="0 0 0">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="{damping:.5f}"
        frictionloss="{rubs:.5f}" armature="{rotor:.6f}"/>
      <inertial pos="{0.5 * length:.4f} 0 0" mass="{mass:.4f}" diaginertia="0.0001 {slender:.7f} {slender:.7f}"/>
    </body>"""
    if drive == "motor":
        limit = 1.8 * load
        motors = [f'    <motor name="motor" joint="hinge" ctrlrange="{-limit:.4f} {limit:.4f}"/>']
        return Robot("pendulum", _model("pendulum", body, motors), drive, (round(limit, 4),))
    bandwidth = rng.uniform(12.0, 22.0)
    kp, kv = inertia * bandwidth**2, 1.4 * inertia * bandwidth
    motors = [
        f'    <position name="servo" joint="hinge" kp="{kp:.4f}" kv="{kv:.5f}" ctrlrange="-3 3" '
        f'forcerange="{-4.0 * load:.4f} {4.0 * load:.4f}"/>'
    ]
    return Robot("servo_pendulum", _model("servo_pendulum", body, motors), drive, (1.4,))


def draw_robot(rng: np.random.Generator) -> Robot:
    """Draw one robot: in one of six cases a cart-pole, else an arm of 3 to 6 joints."""
    if rng.random() < 1.0 / 6.0:
        return cart_pole(rng)
    joints = int(rng.choice([3, 4, 5, 6], p=[0.4, 0.25, 0.2, 0.15]))
    return random_arm(rng, joints, "motor" if rng.random() < 0.5 else "position")


def compiled(robot: Robot) -> mujoco.MjModel:
    """The model as MuJoCo compiles it."""
    return mujoco.MjModel.from_xml_string(robot.xml)


def slides(model: mujoco.MjModel, joint: str) -> bool:
    """Whether a joint is a slide."""
    return model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE


def turned_before(model: mujoco.MjModel, joint: str) -> bool:
    """Whether a hinge between the base and a joint turns the body of this joint."""
    above = model.body_parentid[model.joint(joint).bodyid[0]]
    while above:
        if (model.jnt_type[model.jnt_bodyid == above] == mujoco.mjtJoint.mjJNT_HINGE).any():
            return True
        above = model.body_parentid[above]
    return False


def _weights(mass: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Static moment [kg m] about each joint with the arm stretched out."""
    start = np.concatenate([[0.0], np.cumsum(length)[:-1]])
    middle = start + 0.5 * length
    return np.array(
        [float((mass[j:] * (middle[j:] - start[j])).sum()) for j in range(len(mass))], dtype=float
    )


def _model(name: str, body: str, motors: list[str]) -> str:
    actuators = "\n".join(motors)
    return f"""<mujoco model="{name}">
  <option timestep="0.002" integrator="implicitfast"/>
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
{body}
  </worldbody>
  <actuator>
{actuators}
  </actuator>
</mujoco>
"""


def natural_frequency(robot: Robot) -> float:
    """Frequency [rad/s] around which goals and forces vary: that of a pendulum of the robot's size."""
    return math.sqrt(9.81 / 0.5) if robot.name == "cart_pole" else 4.0
