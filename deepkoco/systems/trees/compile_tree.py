"""From a compiled MuJoCo model to the description of a tree; what a tree cannot hold is refused by name."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np

from deepkoco.systems.trees.actuators import load_actuator, read_actuators
from deepkoco.systems.trees.engine import engine_of
from deepkoco.systems.trees.held_joints import how_to_hold
from deepkoco.systems.trees.inertias import SMALL
from deepkoco.systems.trees.mujoco_library import Model, mujoco_library
from deepkoco.systems.trees.names import Names
from deepkoco.systems.trees.refusals import refuse_what_is_no_tree
from deepkoco.systems.trees.tree import (
    CLOSE,
    Body,
    Frame,
    Joint,
    OutsideForce,
    Site,
    Tree,
    TreeError,
    matrix,
    vector,
)

SLIDE = 2  # mjtJoint.mjJNT_SLIDE


def compile_tree(model: Model, name: str) -> Tree:
    """Describe a model as a tree of hinges and slides.

    Args:
        model: Compiled model.
        name: Name for messages where the model has none.

    Raises:
        TreeError: The model has an element that a contact-free tree of hinges and slides cannot have.
    """
    refuse_what_is_no_tree(model)
    names = Names(model)
    poses = _reference_poses(model)
    joints, last = _joints(model, names)
    bodies = _bodies(model, names, poses, last)
    if not joints:
        raise TreeError("the model has no joints: nothing in it can move")
    _refuse_massless(joints, bodies)
    sites = _sites(model, names, poses, last, bodies)
    actuators = read_actuators(model, names)
    bare = not actuators
    if bare:
        actuators = tuple(load_actuator(joint, j) for j, joint in enumerate(joints))
    firsts = {own.joint: own for own in reversed(actuators)}.values()
    actuators = tuple(sorted(actuators, key=lambda own: own not in firsts))
    notes = [*_left_out(model, names, last), *names.notes]
    gravity = (
        np.zeros(3)
        if model.opt.disableflags & mujoco_library().mjtDisableBit.mjDSBL_GRAVITY
        else model.opt.gravity
    )
    return Tree(
        _model_name(model) or name,
        tuple(joints),
        tuple(bodies),
        actuators,
        sites,
        vector(gravity),
        tuple(notes),
        bare,
        _supports(model, poses, last, gravity),
        engine_of(model),
    )


def _model_name(model: Model) -> str:
    text = bytes(model.names).split(b"\0", 1)[0].decode()
    return "" if text == "MuJoCo Model" else text


def _reference_poses(model: Model) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotation and place of each body's frame in its parent's."""
    return [(_rotation(model.body_quat[b]), np.array(model.body_pos[b])) for b in range(model.nbody)]


def _to_moving(
    model: Model, body: int, poses: Sequence[tuple[np.ndarray, np.ndarray]]
) -> tuple[int, np.ndarray, np.ndarray]:
    """The body with joints that a body is welded to (0 for the world), and the body's frame in its frame."""
    rotation, place, at = np.eye(3), np.zeros(3), body
    while at and not model.body_jntnum[at]:
        own, offset = poses[at]
        rotation, place = own @ rotation, offset + own @ place
        at = int(model.body_parentid[at])
    return at, rotation, place


def _joint_frame(model: Model, j: int) -> tuple[np.ndarray, np.ndarray]:
    """Frame with z along the axis and its origin on it, in the frame of the body at its reference."""
    return _onto_axis(model.jnt_axis[j]), np.array(model.jnt_pos[j])


def _onto_axis(axis: np.ndarray) -> np.ndarray:
    """A rotation whose third column is the axis; of zeros and ones where the axis is one of the frame's."""
    z = axis / np.linalg.norm(axis)
    k = int(np.argmax(np.abs(z)))
    if abs(abs(z[k]) - 1.0) < CLOSE:
        columns = np.zeros((3, 3))
        columns[k, 2] = np.sign(z[k])
        columns[(k + 1) % 3, 0] = 1.0
        columns[(k + 2) % 3, 1] = np.sign(z[k])
        return columns
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _joints(model: Model, names: Names) -> tuple[list[Joint], dict[int, int]]:
    """Joints, and the last joint of each body that has any; the world has -1."""
    poses = _reference_poses(model)
    last = {0: -1}
    joints: list[Joint] = []
    for j in range(model.njnt):
        body = int(model.jnt_bodyid[j])
        rotation, origin = _joint_frame(model, j)
        if body in last:
            parent = last[body]
            before, place = _joint_frame(model, parent)
        else:
            above, turn, at = _to_moving(model, int(model.body_parentid[body]), poses)
            parent = last[above]
            own, offset = poses[body]
            rotation, origin = turn @ own @ rotation, at + turn @ (offset + own @ origin)
            before, place = _joint_frame(model, parent) if parent >= 0 else (np.eye(3), np.zeros(3))
        last[body] = j
        d, q = int(model.jnt_dofadr[j]), int(model.jnt_qposadr[j])
        limited, forced = bool(model.jnt_limited[j]), bool(model.jnt_actfrclimited[j])
        low, high = model.jnt_range[j] if limited else (-np.inf, np.inf)
        weakest, strongest = model.jnt_actfrcrange[j] if forced else (-np.inf, np.inf)
        joints.append(
            Joint(
                names.joints[j],
                bool(model.jnt_type[j] == SLIDE),
                parent,
                Frame(matrix(before.T @ rotation), vector(before.T @ (origin - place))),
                float(model.qpos0[q]),
                float(low),
                float(high),
                float(model.dof_damping[d]),
                float(model.dof_frictionloss[d]),
                float(model.dof_armature[d]),
                float(np.ravel(model.jnt_stiffness[j])[0]),
                float(model.qpos_spring[q]),
                float(weakest),
                float(strongest),
            )
        )
    return joints, last


def _bodies(
    model: Model,
    names: Names,
    poses: Sequence[tuple[np.ndarray, np.ndarray]],
    last: dict[int, int],
) -> list[Body]:
    """Bodies with joints, with everything that is welded to them."""
    gathered: dict[int, list[tuple[str, float, np.ndarray, np.ndarray]]] = {b: [] for b in last if b}
    for b in range(1, model.nbody):
        top, rotation, place = _to_moving(model, b, poses)
        if not top:
            continue
        centre = place + rotation @ model.body_ipos[b]
        axes = rotation @ _rotation(model.body_iquat[b])
        inertia = axes @ np.diag(model.body_inertia[b]) @ axes.T
        gathered[top].append((names.bodies[b], float(model.body_mass[b]), centre, inertia))
    result = []
    for b, parts in gathered.items():
        mass = sum(part[1] for part in parts)
        com = sum((part[1] * part[2] for part in parts), np.zeros(3)) / mass if mass > 0.0 else np.zeros(3)
        inertia = np.zeros((3, 3))
        for _, own, centre, central in parts:
            arm = centre - com
            inertia += central + own * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        moments, axes = _principal(inertia, _rotation(model.body_iquat[b]), model.body_inertia[b], len(parts))
        rotation, origin = _joint_frame(model, last[b])
        frame = Frame(matrix(rotation.T), vector(-rotation.T @ origin))
        welded = tuple(part[0] for part in parts[1:] if part[1] > 0.0)
        result.append(
            Body(
                names.bodies[b],
                last[b],
                frame,
                float(mass),
                vector(com),
                matrix(axes),
                vector(moments),
                welded,
            )
        )
    return result


def _supports(
    model: Model,
    poses: Sequence[tuple[np.ndarray, np.ndarray]],
    last: dict[int, int],
    gravity: np.ndarray,
) -> tuple[OutsideForce, ...]:
    """What gravcomp puts on each body: a share of its weight, upwards, at its centre of mass."""
    found = []
    for b in range(1, model.nbody):
        top, rotation, place = _to_moving(model, b, poses)
        force = -float(model.body_gravcomp[b] * model.body_mass[b]) * np.asarray(gravity)
        if top and force.any():
            inner, origin = _joint_frame(model, last[top])
            centre = place + rotation @ model.body_ipos[b]
            found.append(OutsideForce(last[top], vector(inner.T @ (centre - origin)), vector(force)))
    return tuple(found)


def _principal(
    inertia: np.ndarray, own_axes: np.ndarray, own_moments: np.ndarray, parts: int
) -> tuple[np.ndarray, np.ndarray]:
    """Principal moments and axes; each axis is named after the axis of the body's frame that is next to it."""
    moments, axes = (own_moments.copy(), own_axes) if parts == 1 else np.linalg.eigh(inertia)
    near = np.abs(axes)
    order = max(permutations(range(3)), key=lambda p: near[0, p[0]] + near[1, p[1]] + near[2, p[2]])
    order = list(order)
    axes, moments = axes[:, order], moments[order]
    axes = axes * np.where(np.diag(axes) < 0.0, -1.0, 1.0)
    return moments, axes


def _refuse_massless(joints: Sequence[Joint], bodies: Sequence[Body]) -> None:
    carried = np.zeros(len(joints))
    for body in bodies:
        at = body.joint
        while at >= 0:
            carried[at] += body.mass
            at = joints[at].parent
    for joint, mass in zip(joints, carried, strict=True):
        # Frames between two joints have next to none.
        if not mass > len(bodies) * SMALL and not joint.armature > 0.0:
            raise TreeError(
                f'nothing behind the joint "{joint.name}" has a mass; give its body an <inertial> or a geom with a '
                f"mass, or hold it: {how_to_hold([joint.name])}"
            )


def _sites(
    model: Model,
    names: Names,
    poses: Sequence[tuple[np.ndarray, np.ndarray]],
    last: dict[int, int],
    bodies: Sequence[Body],
) -> tuple[Site, ...]:
    """Sites of the model on moving bodies, then the centre of mass of each moving body."""
    found = []
    for s in range(model.nsite):
        top, rotation, place = _to_moving(model, int(model.site_bodyid[s]), poses)
        if not top:
            continue
        inner, origin = _joint_frame(model, last[top])
        at = place + rotation @ model.site_pos[s]
        found.append(Site(names.sites[s], last[top], vector(inner.T @ (at - origin))))
    taken = {site.name for site in found}
    for body in bodies:
        if body.name not in taken:
            at = np.array(body.frame.offset) + np.array(body.frame.rotation) @ np.array(body.com)
            found.append(Site(body.name, body.joint, vector(at)))
    return tuple(found)


def _left_out(model: Model, names: Names, last: dict[int, int]) -> list[str]:
    """Sentences on physics of the model that the tree leaves out."""
    notes = []
    if _may_collide(model):
        notes.append("contacts are not simulated, although geoms of the model can collide")
    limited = [names.joints[j] for j in range(model.njnt) if model.jnt_limited[j]]
    if limited:
        notes.append(f"limits of joints are not simulated: {', '.join(limited)}")
    tendons = [names.tendons[t] for t in range(model.ntendon) if model.tendon_limited[t]]
    if tendons:
        notes.append(f"limits of tendons are not simulated: {', '.join(tendons)}")
    if not model.nu:
        notes.append(
            "the file has no drives: a load acts on each joint, and the inertia of a rotor and damping are estimated "
            "from logs, with wide priors"
        )
    if model.opt.density or model.opt.viscosity:
        notes.append("the drag of the medium (density, viscosity) is not simulated")
    return notes


def _may_collide(model: Model) -> bool:
    if model.npair:
        return True
    kinds = model.geom_contype, model.geom_conaffinity
    acting = [g for g in range(model.ngeom) if kinds[0][g] or kinds[1][g]]
    welds = model.body_weldid
    for i, g in enumerate(acting):
        for other in acting[:i]:
            one, two = int(welds[model.geom_bodyid[g]]), int(welds[model.geom_bodyid[other]])
            parents = int(welds[model.body_parentid[one]]), int(welds[model.body_parentid[two]])
            # Neighbours do not collide, unless the parent is the world.
            if one == two or (one and two and (parents[0] == two or parents[1] == one)):
                continue
            if (kinds[0][g] & kinds[1][other]) or (kinds[0][other] & kinds[1][g]):
                return True
    return False


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
