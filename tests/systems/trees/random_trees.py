"""Random robots as MJCF, and logs of them that MuJoCo itself simulates."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from torch import Tensor

from deepkoco.logs.recording import Recording, Series
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.compile_tree import compile_tree

PI = float(np.pi)


def random_mjcf(rng: np.random.Generator, most: int = 7) -> str:
    """A tree of up to ``most`` hinges and slides with random axes, offsets, inertias, springs, damping and actuators.

    Some bodies have two joints, some none (they are welded to their parent), some a shifted reference.
    """
    count = int(rng.integers(1, most + 1))
    bodies: list[dict] = []
    made = 0
    while made < count:
        joints = min(count - made, int(rng.choice([0, 1, 1, 1, 2], 1)[0]) if bodies else 1)
        bodies.append({"parent": int(rng.integers(-1, len(bodies))) if bodies else -1, "joints": []})
        bodies[-1]["joints"] = [made + k for k in range(joints)]
        made += joints

    def vector(size: float, n: int = 3) -> str:
        return " ".join(f"{x:.17g}" for x in rng.normal(size=n) * size)

    def joint(k: int, taken: set[str]) -> str:
        kind = "slide" if rng.random() < 0.25 else "hinge"
        reference = f'ref="{rng.normal() * 0.3:.6g}"' if rng.random() < 0.3 else ""
        spring = f'stiffness="{rng.uniform(0, 5):.6g}" springref="{rng.normal() * 0.5:.6g}"' * (
            rng.random() < 0.5
        )
        usual = ["1 0 0", "0 -1 0", "0 0 1"]
        axis = str(rng.choice(usual)) if rng.random() < 0.4 else vector(1.0)
        if kind == "slide" and axis in taken:
            axis = next(other for other in usual if other not in taken)  # two slides along one axis are one
        taken.add(axis)
        return (
            f'<joint name="j{k}" type="{kind}" axis="{axis}" pos="{vector(0.1)}" damping="{rng.uniform(0, 0.5):.6g}" '
            f'armature="{rng.uniform(0, 0.05) * (rng.random() < 0.7):.6g}" {reference} {spring}/>'
        )

    def body(index: int) -> str:
        own = bodies[index]
        moments = np.sort(rng.uniform(0.2, 1.0, 3)) ** 2 * 10.0 ** rng.uniform(-4, -1)
        moments[2] = min(moments[2], 0.99 * (moments[0] + moments[1]))
        moment = " ".join(f"{x:.17g}" for x in rng.permutation(moments))
        taken: set[str] = set()
        inside = "".join(joint(k, taken) for k in own["joints"])
        inside += (
            f'<inertial pos="{vector(0.1)}" quat="{vector(1.0, 4)}" mass="{10.0 ** rng.uniform(-1, 1):.17g}" '
            f'diaginertia="{moment}"/>'
        )
        inside += "".join(body(k) for k, other in enumerate(bodies) if other["parent"] == index)
        return f'<body name="b{index}" pos="{vector(0.3)}" quat="{vector(1.0, 4)}">{inside}</body>'

    def actuator(k: int) -> str:
        kind = rng.choice(["motor", "position", "velocity", "general", "none"])
        gear = f'gear="{rng.normal() * 3:.6g}"'
        limit = f'ctrlrange="{-rng.uniform(0.1, 2):.6g} {rng.uniform(0.1, 2):.6g}"' * (rng.random() < 0.5)
        limit += f' forcerange="{-rng.uniform(1, 20):.6g} {rng.uniform(1, 20):.6g}"' * (rng.random() < 0.5)
        law = {
            "motor": "",
            "position": f'kp="{rng.uniform(1, 50):.6g}" kv="{rng.uniform(0, 3):.6g}"',
            "velocity": f'kv="{rng.uniform(0.1, 5):.6g}"',
            "general": f'gainprm="{rng.uniform(1, 9):.6g}" biastype="affine" biasprm="{vector(1.0)}"',
            "none": "",
        }[kind]
        return "" if kind == "none" else f'<{kind} name="a{k}" joint="j{k}" {gear} {limit} {law}/>'

    return (
        f'<mujoco><compiler autolimits="true"/><option gravity="{vector(6.0)}"/>'
        f"<worldbody>{''.join(body(k) for k, own in enumerate(bodies) if own['parent'] < 0)}</worldbody>"
        f"<actuator>{''.join(actuator(k) for k in range(count))}</actuator></mujoco>"
    )


def random_tree(seed: int, most: int = 7) -> tuple[mujoco.MjModel, TreeSystem]:
    """A random robot for MuJoCo and for us."""
    model = mujoco.MjModel.from_xml_string(random_mjcf(np.random.default_rng(seed), most))
    return model, TreeSystem(compile_tree(model, "random"))


def mujoco_accelerations(
    model: mujoco.MjModel, angles: np.ndarray, speeds: np.ndarray, controls: np.ndarray, loads: np.ndarray
) -> np.ndarray:
    """(n, J) accelerations that MuJoCo computes for states (n, J), controls (n, M) and loads (n, J)."""
    data, result = mujoco.MjData(model), []
    if not model.nu:
        # Its system has a command in N m or N for each joint.
        controls, loads = loads[:, :0], loads + controls
    for q, v, u, load in zip(angles, speeds, controls, loads, strict=True):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, load
        data.ctrl[:] = u
        mujoco.mj_forward(model, data)
        result.append(data.qacc.copy())
    return np.array(result)


def random_motions(rng: np.random.Generator, model: mujoco.MjModel, count: int) -> tuple[np.ndarray, ...]:
    """Angles and speeds (n, J), commands (n, M) and outside loads (n, J)."""
    shapes = (model.nv, model.nv, model.nu or model.nv, model.nv)
    return tuple(rng.normal(size=(count, n)) for n in shapes)


def columns(values: np.ndarray) -> tuple[Tensor, ...]:
    """(n, J) -> J tensors (n,)."""
    return tuple(torch.from_numpy(np.ascontiguousarray(column)) for column in values.T)


def mujoco_log(
    model: mujoco.MjModel,
    system: TreeSystem,
    commands: np.ndarray,
    rate: float,
    rng: np.random.Generator,
    noise: float = 1e-4,
) -> Recording:
    """A log of MuJoCo's own simulation: angles with noise, and the commands, which hold from stamp to stamp.

    Args:
        model: Robot; its timestep is the step of the simulation.
        system: Gives the channels.
        commands: (n, M) one row per stamp.
        rate: Stamps per second [Hz].
        rng: Noise.
        noise: Standard deviation of the positions [rad or m].
    """
    data, rows = mujoco.MjData(model), []
    for row in commands:
        rows.append(data.qpos.copy())
        data.ctrl[:] = row
        for _ in range(round(1.0 / rate / model.opt.timestep)):
            mujoco.mj_step(model, data)
    t, shown = np.arange(len(rows)) / rate, np.array(rows)
    shown = shown + noise * rng.standard_normal(shown.shape)
    channels = {
        f"q_{name}": Series(t, shown[:, j], system.state_units[j], "measurement")
        for j, name in enumerate(system.joint_names)
    }
    for k, command in enumerate(system.commands):
        channels[command.name] = Series(t, commands[:, k], command.unit, "command")
    return Recording(channels)
