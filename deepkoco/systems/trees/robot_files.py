"""Write a mended robot to a folder: robot_extended.xml, and changes.md in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems.system import System
from deepkoco.systems.trees.parameters import is_servo
from deepkoco.systems.trees.tree_system import TreeSystem
from deepkoco.systems.trees.write_back import Change, WriteBack, extended_mjcf, tree_of
from deepkoco.systems.trees.write_bodies import FITTED

ROBOT_FILE, CHANGES_FILE = "robot_extended.xml", "changes.md"
PHYSICS_STEP = 0.005  # [s], of usual training environments; lags are counted in it


def write_robot(system: System, folder: str | Path, final: str | Path | None = None) -> tuple[Path, Path]:
    """Write a robot with its effects as MJCF, and what changed.

    Args:
        system: A robot read from MJCF or URDF, with or without effects.
        folder: Folder that exists.
        final: Folder to which the files will be moved, if another; the paths of meshes are relative to it.

    Returns:
        The MJCF file and the text.

    Raises:
        TreeError: The system was not read from a file.
        FileExistsError: A file is there already.
        WriteError: The disk is full, or the place cannot be written.
    """
    folder = Path(folder)
    paths = folder / ROBOT_FILE, folder / CHANGES_FILE
    for path in paths:
        if path.exists():
            raise FileExistsError(f"{path} exists; choose another folder")
    written = extended_mjcf(system, folder if final is None else final)
    write_whole_text(paths[0], written.xml)
    write_whole_text(paths[1], changes_text(system, written))
    return paths


def changes_text(system: System, written: WriteBack) -> str:
    """changes.md: every number that changed, what the file cannot hold, and values for other simulators."""
    robot = tree_of(system)
    lines = [f"# Changes of {system.name}", ""]
    if robot is not None:
        lines += [f"`{ROBOT_FILE}` is `{robot.origin}` with these changes.", ""]
        lines += ["", *(f"- {note}" for note in robot.notes), ""] if robot.notes else []
    found = [c for c in written.changes if c.reason != FITTED]
    fitted = [c for c in written.changes if c.reason == FITTED]
    if not written.changes:
        lines += ["No number changed."]
    lines += _table(found)
    if found and fitted:
        lines += [
            "",
            "The model's own values, fitted together with these; the report has their intervals:",
            "",
        ]
    lines += _table(fitted)
    if written.first_order:
        lines += [
            "",
            f'MuJoCo\'s integrator "{written.first_order}" is of first order: motions are late by about half a time '
            'step, also without these changes. With `integrator="RK4"` the file moves as the diagnosis simulated it.',
        ]
    lines += ["", "## Not in the file", ""]
    lines += [f"- {text}" for text in written.left_out] or ["Nothing: the file holds every effect."]
    if robot is not None:
        lines += ["", *_other_simulators(system, robot)]
    return "\n".join(lines) + "\n"


def _table(changes: Sequence[Change]) -> list[str]:
    if not changes:
        return []
    lines = ["| element | what | before | after | unit | why |", "|---|---|---|---|---|---|"]
    return lines + [
        f"| {c.element} | {c.attribute} | {c.before:.6g} | {c.after:.6g} | {c.unit} | {c.reason} |"
        for c in changes
    ]


def _other_simulators(system: System, robot: TreeSystem) -> list[str]:
    groups = [_actuator(system, robot, k) for k in range(len(robot.commands))]
    lines = ["## Values for mjlab and Isaac Lab", ""]
    if not groups:
        return [*lines, "The robot has no actuators."]
    step = f"{1000 * PHYSICS_STEP:g} ms"
    lines += [
        f"Lags count physics steps of {step}; with another step, divide the delay by it. Dry friction and armature "
        "belong to the joint.",
        "",
        "```python",
        *(line for group in groups for line in _mjlab(group)),
        "```",
        "",
        "```python",
        *(line for group in groups for line in _isaac_lab(group)),
        "```",
    ]
    motors = [str(g["name"]) for g in groups if "stiffness" not in g]
    if motors:
        lines += [
            "",
            f"Commands of {', '.join(motors)} are no goals of a position, so they have no stiffness here.",
        ]
    return lines


def _actuator(system: System, robot: TreeSystem, index: int) -> dict[str, float | str]:
    """What one actuator and its joint amount to, in the quantities of a PD drive."""
    actuator = robot.tree.actuators[index]
    joint, values = robot.tree.joints[actuator.joint], {p.name: p.value for p in system.parameters}
    own = values.get

    def at_joint(kind: str, effect: str, parameter: str) -> float:
        placed = robot.at_joint(effect, actuator.joint)
        base = own(f"{kind}({joint.name})", float(getattr(joint, kind)))
        return max(base + own(f"{placed}.{parameter}", 0.0), 0.0)

    gear = actuator.gear
    found: dict[str, float | str] = {
        "name": joint.name,
        "armature": own(f"armature({joint.name})", joint.armature),
        "friction": at_joint("frictionloss", "coulomb", "torque"),
        "viscous": at_joint("damping", "viscous", "change"),
    }
    if is_servo(actuator):
        stiffness = own(f"kp({actuator.name})", actuator.gain[0])
        damping = own(f"kv({actuator.name})", -actuator.bias[2])
        found |= {"stiffness": stiffness * gear**2, "damping": damping * gear**2}
    limit = abs(gear) * min(abs(actuator.force_low), abs(actuator.force_high))
    if math.isfinite(limit):
        found["limit"] = limit
    names = (robot.at_joint("actuation_delay", actuator.joint), "actuation_delay(all)")
    delay = own(f"delay({actuator.name})", actuator.delay) + sum(own(f"{name}.delay", 0.0) for name in names)
    found["lag"] = delay / PHYSICS_STEP
    return found


def _lags(group: dict[str, float | str]) -> tuple[int, int]:
    lag = float(group["lag"])
    return math.floor(lag + 1e-9), math.ceil(lag - 1e-9)


def _mjlab(group: dict[str, float | str]) -> list[str]:
    low, high = _lags(group)
    servo = "stiffness" in group
    fields = [f'target_names_expr=("{group["name"]}",)']
    fields += _fields(group, (("stiffness", "stiffness"), ("damping", "damping"), ("limit", "effort_limit")))
    fields += _fields(
        group, (("armature", "armature"), ("friction", "frictionloss"), ("viscous", "viscous_damping"))
    )
    base = "BuiltinPositionActuatorCfg" if servo else "BuiltinMotorActuatorCfg"
    target = "position" if servo else "effort"
    inner = f"{base}({', '.join(fields)})"
    return [
        "DelayedActuatorCfg(",
        f"    base_cfg={inner},",
        f'    delay_target="{target}", delay_min_lag={low}, delay_max_lag={high},',
        ")",
    ]


def _isaac_lab(group: dict[str, float | str]) -> list[str]:
    low, high = _lags(group)
    fields = [f'joint_names_expr=["{group["name"]}"]']
    gains = group if "stiffness" in group else {**group, "stiffness": 0.0, "damping": 0.0}
    fields += _fields(gains, (("stiffness", "stiffness"), ("damping", "damping"), ("limit", "effort_limit")))
    fields += _fields(
        gains, (("armature", "armature"), ("friction", "friction"), ("friction", "dynamic_friction"))
    )
    fields += _fields(gains, (("viscous", "viscous_friction"),))
    return [f"DelayedPDActuatorCfg({', '.join(fields)}, min_delay={low}, max_delay={high})"]


def _fields(group: dict[str, float | str], names: Sequence[tuple[str, str]]) -> list[str]:
    return [f"{name}={float(group[key]):.6g}" for key, name in names if key in group]
