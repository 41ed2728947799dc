"""Arms as URDF files, and their motion in MuJoCo and in Bullet: units whose logs a user without hardware would write.

Bullet is asked through pybullet, which is no part of the package and of no extra: ``pip install pybullet`` (3.2.7) in
an environment of its own, with its folder on the PYTHONPATH, or in this one.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Protocol

import numpy as np

from deepkoco.systems.trees.mujoco_library import mujoco_library

GRAVITY = 9.81  # [m/s2]
# Joint: axis, then the rows of its link's inertia over mass * length^2 (about x, along it; y; z).
AXES = {"yaw": "0 0 1", "shoulder": "0 1 0", "elbow": "0 1 0", "wrist": "0 1 0"}
SLENDER = (0.02, 0.11, 0.11)
LINK = """
  <link name="{name}_link"><inertial><origin xyz="{middle:.6g} 0 0"/><mass value="{mass:.6g}"/>
    <inertia ixx="{ixx:.6g}" iyy="{iyy:.6g}" izz="{izz:.6g}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}_link"/>
    <origin xyz="{offset:.6g} 0 {height:.6g}"/><axis xyz="{axis}"/><limit lower="-3.1" upper="3.1" effort="50"
    velocity="100"/><dynamics damping="{damping:.6g}" friction="{friction:.6g}"/></joint>"""


def urdf_of(joints: Sequence[str], values: Mapping[str, float], payload: float = 0.0) -> str:
    """Return the file of an arm of slender links, one behind the other.

    Args:
        joints: Of `AXES`, from the base on.
        values: ``length_JOINT`` [m], ``mass_JOINT`` [kg], ``damping_JOINT`` [N m s/rad], ``friction_JOINT`` [N m].
        payload: Point mass at the end of the last link [kg].
    """
    text, parent, offset = '<?xml version="1.0"?>\n<robot name="arm">\n  <link name="base"/>', "base", 0.0
    for k, name in enumerate(joints):
        own, length, mass = SLENDER, values[f"length_{name}"], values[f"mass_{name}"]
        middle, inertia = 0.45 * length, [share * mass * length**2 for share in own]
        if payload and k == len(joints) - 1:
            whole = mass + payload
            apart = (
                mass * payload / whole * (length - middle) ** 2
            )  # the parallel axis theorem, for both parts
            inertia[1], inertia[2] = inertia[1] + apart, inertia[2] + apart
            middle, mass = (mass * middle + payload * length) / whole, whole
        text += LINK.format(
            name=name, parent=parent, middle=middle, mass=mass, ixx=inertia[0], iyy=inertia[1], izz=inertia[2],
            offset=offset, height=0.0 if k else 0.1, axis=AXES[name], damping=values[f"damping_{name}"],
            friction=values[f"friction_{name}"],
        )  # fmt: skip
        parent, offset = f"{name}_link", length
    return text + "\n</robot>\n"


class Plant(Protocol):
    """A robot in an engine."""

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Angles [rad] and speeds [rad/s] of the joints (J,)."""
        ...

    def advance(self, torques: np.ndarray) -> None:
        """Take one step of the engine under constant torques (J,) [N m]."""
        ...

    def close(self) -> None:
        """Give back what the engine holds."""
        ...


class InMujoco:
    """MuJoCo with the options of a URDF file that states none but its step: Euler, soft friction.

    Args:
        path: The URDF file.
        angles: Of the joints at the start [rad].
        step: Of the engine [s].
    """

    def __init__(self, path: Path, angles: np.ndarray, friction: Sequence[float], step: float) -> None:
        self._engine = mujoco_library()
        self._model = self._engine.MjModel.from_xml_path(str(path))
        self._model.opt.timestep = step
        self._data = self._engine.MjData(self._model)
        self._data.qpos[:] = angles

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        return self._data.qpos.copy(), self._data.qvel.copy()

    def advance(self, torques: np.ndarray) -> None:
        self._data.qfrc_applied[:] = torques
        self._engine.mj_step(self._model, self._data)

    def close(self) -> None:
        pass


class InBullet:
    """Bullet as its examples drive an arm: torques, and dry friction as motors with the target 0.

    Links have no damping of their own; Bullet gives them 0.04 1/s where nobody says otherwise, and no file states it.

    Args:
        path, angles, step: As for :class:`InMujoco`.
        friction: Of the joints [N m]; Bullet does not take it from the file where torques are commanded.
    """

    def __init__(self, path: Path, angles: np.ndarray, friction: Sequence[float], step: float) -> None:
        import pybullet as bullet  # pyright: ignore[reportMissingImports]

        self._engine, self._client = bullet, bullet.connect(bullet.DIRECT)
        self._own = {"physicsClientId": self._client}
        bullet.setGravity(0.0, 0.0, -GRAVITY, **self._own)
        bullet.setTimeStep(step, **self._own)
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        self._robot = bullet.loadURDF(str(path), useFixedBase=True, flags=flags, **self._own)
        self._joints = list(range(len(angles)))
        for j in (-1, *self._joints):
            bullet.changeDynamics(self._robot, j, linearDamping=0.0, angularDamping=0.0, **self._own)
        for j, (angle, level) in enumerate(zip(angles, friction, strict=True)):
            bullet.setJointMotorControl2(
                self._robot, j, bullet.VELOCITY_CONTROL, targetVelocity=0.0, force=level, **self._own
            )
            bullet.resetJointState(self._robot, j, float(angle), **self._own)

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        found = self._engine.getJointStates(self._robot, self._joints, **self._own)
        return np.array([x[0] for x in found]), np.array([x[1] for x in found])

    def advance(self, torques: np.ndarray) -> None:
        self._engine.setJointMotorControlArray(
            self._robot,
            self._joints,
            self._engine.TORQUE_CONTROL,
            forces=[float(x) for x in torques],
            **self._own,
        )
        self._engine.stepSimulation(**self._own)

    def close(self) -> None:
        self._engine.disconnect(**self._own)


ENGINES = {"mujoco": InMujoco, "bullet": InBullet}


def has_engine(name: str) -> bool:
    """Whether an engine of `ENGINES` can be imported here."""
    return name != "bullet" or importlib.util.find_spec("pybullet") is not None


def version_of(name: str) -> str:
    """Version of an engine of `ENGINES`."""
    try:
        return metadata.version("pybullet" if name == "bullet" else name)
    except metadata.PackageNotFoundError:  # on the path without its metadata
        return "unknown"


def holding(joints: Sequence[str], values: Mapping[str, float]) -> np.ndarray:
    """Largest torque with which gravity pulls at each joint, the arm stretched out [N m] (J,); 0 about the vertical."""
    length = [values[f"length_{j}"] for j in joints]
    most = []
    for k, name in enumerate(joints):
        arms = [sum(length[k:i]) + 0.45 * length[i] for i in range(k, len(joints))]
        pull = sum(values[f"mass_{joints[k + i]}"] * arm for i, arm in enumerate(arms))
        most.append(0.0 if AXES[name] == "0 0 1" else GRAVITY * pull)
    return np.array(most)


def reach(joints: Sequence[str], values: Mapping[str, float]) -> np.ndarray:
    """Inertia that each joint moves with the arm stretched out, about [kg m2] (J,)."""
    length = [values[f"length_{j}"] for j in joints]
    found = []
    for k in range(len(joints)):
        arms = [sum(length[k:i]) + 0.6 * length[i] for i in range(k, len(joints))]
        found.append(sum(values[f"mass_{joints[k + i]}"] * arm**2 for i, arm in enumerate(arms)))
    return np.array(found)


def turns_of(count: int) -> float:
    """Size of a count of an encoder with so many per turn [rad]."""
    return 2.0 * math.pi / count
