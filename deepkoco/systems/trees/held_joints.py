"""Joints that are held: they are taken out of a model, and with them what acts on them alone."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deepkoco.suggestion import did_you_mean
from deepkoco.systems.trees.mujoco_library import mujoco_library
from deepkoco.systems.trees.tree import TreeError


class Follower(NamedTuple):
    """A joint at ``offset + ratio q`` of another one, the leader [rad or m]; without a leader it stands still."""

    name: str
    leader: str
    offset: float
    ratio: float


def hold_joints(spec: Any, held: Mapping[str, float], kept: Collection[str] = ()) -> tuple[str, ...]:
    """Take joints out of a specification, so that their bodies are fixed to what carries them.

    A joint that follows another (``<mimic>``, an equality of joints) is held too if no free joint lies behind it, as
    fingers of grippers are: the joints of a tree are free.
    Actuators, tendons, equalities and sensors go with the joints that they act on; so do keyframes, which list a
    position for each joint.

    Args:
        spec: The specification (`mujoco.MjSpec`); it is changed.
        held: Position [rad, m] by name of the joint, or by a pattern of names; NaN stands for the position in which the
            model is drawn. A joint without a name has that of its body.
        kept: Names of joints that follow others and stay joints of the tree; see :class:`.FollowingSystem`.

    Returns:
        Sentences on what is held.

    Raises:
        TreeError: There is no such joint, or one cannot be held alone; the message names it.
    """
    joints = {joint_name(joint): joint for joint in spec.joints}
    chosen = chosen_joints(spec, held)
    notes = [f"held, as the settings say: {', '.join(chosen)}"] if chosen else []
    found = followers(spec, chosen)
    for follower in found:
        if follower.name in kept:
            continue
        chosen[follower.name] = follower.offset
        alone = "" if follower.leader in chosen else f': "{follower.leader}" moves its own bodies alone'
        notes.append(f'the joint "{follower.name}" follows "{follower.leader}" and is held{alone}')
    for equality in list(spec.equalities):
        # Bodies and sites may have the names of joints; what couples these is no matter of a follower.
        coupled = equality.type == mujoco_library().mjtEq.mjEQ_JOINT
        if coupled and (equality.name1 in kept or equality.name2 in kept):
            spec.delete(equality)
    if not chosen:
        return ()
    moved = {name: by for name, by in chosen.items() if by != 0.0}
    if moved:
        compiled = spec.copy()
        model = compiled.compile()
        ids = {joint_name(joint): (joint.id, joint.parent.id) for joint in compiled.joints}
        for name, by in moved.items():
            _displace(joints[name], by, model, *ids[name])
    _delete(spec, chosen, joints)
    return tuple(notes)


def how_to_hold(joints: Sequence[str], file: str = "ROBOT.xml") -> str:
    """What a user writes where to hold joints of a robot's file."""
    names, path = ", ".join(f'"{name}"' for name in joints), Path(file)
    return f"write held: [{names}] into {path.stem}.parameters.yaml beside {path.name}"


def joint_name(joint: Any) -> str:
    """Name of a joint; that of its body where it has none."""
    return joint.name or joint.parent.name


def chosen_joints(spec: Any, held: Mapping[str, float]) -> dict[str, float]:
    """Displacement of each joint that is held from the position in which the model is drawn [rad or m].

    Raises:
        TreeError: There is no such joint.
    """
    joints = {joint_name(joint): joint for joint in spec.joints}
    chosen: dict[str, float] = {}
    for pattern, position in held.items():
        found = [name for name in joints if fnmatchcase(name, pattern)]
        if not found:
            hint = did_you_mean(pattern, list(joints)) or ";"
            raise TreeError(f'held: there is no joint "{pattern}"{hint} known: {", ".join(joints)}')
        for name in found:
            chosen[name] = 0.0 if np.isnan(position) else position - _reference(spec, joints[name])
    return chosen


def followers(spec: Any, chosen: Mapping[str, float]) -> list[Follower]:
    """Joints that follow others or are fixed by an equality, without free joints behind them.

    Args:
        spec: The specification (`mujoco.MjSpec`).
        chosen: Joints that are held in any case, by name.
    """
    joint_equality = mujoco_library().mjtEq.mjEQ_JOINT
    moved = {a.target for a in spec.actuators}
    joints = {joint.name: joint for joint in spec.joints}
    found: dict[str, Follower] = {}
    for equality in spec.equalities:
        if equality.type != joint_equality or not equality.active:
            continue
        name, leader = equality.name1, equality.name2
        offset, ratio = float(equality.data[0]), float(equality.data[1])
        if name not in joints or (leader and leader not in joints):
            continue  # MuJoCo says so when it compiles
        if leader and name in moved and leader not in moved:
            name, leader = leader, name
            # The line read the other way.
            offset, ratio = (-offset / ratio, 1.0 / ratio) if ratio else (0.0, 0.0)
        if any(float(c) for c in equality.data[2:5]):
            ratio = 0.0  # no straight line: what follows it is held
        if name not in chosen:
            found.setdefault(name, Follower(name, leader or equality.name or "an equality", offset, ratio))
    still = {*found, *chosen}
    return [own for name, own in found.items() if not _carries_joints(joints[name].parent, still)]


def _carries_joints(body: Any, still: set[str]) -> bool:
    """Whether joints lie behind a body that are not among those that stand still."""
    return any(
        any(joint.name not in still for joint in child.joints) or _carries_joints(child, still)
        for child in body.bodies
    )


def _reference(spec: Any, joint: Any) -> float:
    """Position of a joint [rad, m] in which the model is drawn."""
    degrees = spec.compiler.degree and joint.type == mujoco_library().mjtJoint.mjJNT_HINGE
    return float(np.radians(joint.ref) if degrees else joint.ref)


def _displace(joint: Any, by: float, model: Any, j: int, b: int) -> None:
    """Move the body of a joint to where the joint holds it; j and b are their numbers in the compiled model."""
    mujoco, body = mujoco_library(), joint.parent
    types = mujoco.mjtJoint
    if joint.type not in (types.mjJNT_HINGE, types.mjJNT_SLIDE) or len(list(body.joints)) > 1:
        raise TreeError(
            f'held: "{joint_name(joint)}" is no hinge or slide that moves its body alone, so it can only be held where '
            "the model is drawn; leave its position out"
        )
    turn, own, quaternion = np.empty(9), np.empty(4), np.empty(4)
    mujoco.mju_quat2Mat(turn, model.body_quat[b])
    turn, axis, at = turn.reshape(3, 3), model.jnt_axis[j], model.jnt_pos[j]
    if joint.type == types.mjJNT_SLIDE:
        body.pos = model.body_pos[b] + turn @ (by * axis)
        return
    mujoco.mju_axisAngle2Quat(own, axis, by)
    moved = np.empty(3)
    mujoco.mju_rotVecQuat(moved, at, own)
    mujoco.mju_mulQuat(quaternion, model.body_quat[b], own)
    body.pos = model.body_pos[b] + turn @ (at - moved)
    body.alt.type, body.quat = mujoco.mjtOrientation.mjORIENTATION_QUAT, quaternion


def _delete(spec: Any, chosen: Mapping[str, float], joints: Mapping[str, Any]) -> None:
    """Take joints out, and what acts on them alone."""
    mujoco = mujoco_library()
    objects, transmissions = mujoco.mjtObj, mujoco.mjtTrn
    gone = {(objects.mjOBJ_JOINT, joints[name].name) for name in chosen if joints[name].name}
    for tendon in list(spec.tendons):
        wraps = [tendon.path[i] for i in range(len(tendon.path))]
        on = [wrap.target.name for wrap in wraps if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT]
        left = [name for name in on if name not in chosen]
        if on and not left:
            gone.add((objects.mjOBJ_TENDON, tendon.name))
            spec.delete(tendon)
        elif len(left) < len(on):
            raise TreeError(
                f'the tendon "{tendon.name}" acts on joints that are held and on {", ".join(left)}; hold these too: '
                f"{how_to_hold(left)}"
            )
    kinds = {
        transmissions.mjTRN_JOINT: objects.mjOBJ_JOINT,
        transmissions.mjTRN_JOINTINPARENT: objects.mjOBJ_JOINT,
        transmissions.mjTRN_TENDON: objects.mjOBJ_TENDON,
    }
    for actuator in list(spec.actuators):
        if (kinds.get(actuator.trntype), actuator.target) in gone:
            gone.add((objects.mjOBJ_ACTUATOR, actuator.name))
            spec.delete(actuator)
    for equality in list(spec.equalities):
        own = {
            mujoco.mjtEq.mjEQ_JOINT: objects.mjOBJ_JOINT,
            mujoco.mjtEq.mjEQ_TENDON: objects.mjOBJ_TENDON,
        }.get(equality.type)
        if own and ((own, equality.name1) in gone or (own, equality.name2) in gone):
            spec.delete(equality)
    for sensor in list(spec.sensors):
        if (sensor.objtype, sensor.objname) in gone:
            spec.delete(sensor)
    for key in list(spec.keys):
        spec.delete(key)
    for name in chosen:
        spec.delete(joints[name])
