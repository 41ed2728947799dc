"""From a compiled MuJoCo model to the description of a tree; what a tree cannot hold is refused by name."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np

from deepkoco.systems.system import UNREADABLE
from deepkoco.systems.trees.tree import Actuator, Body, Frame, Joint, Matrix, Site, Tree, TreeError, Vector

if TYPE_CHECKING:
    import mujoco

OTHERWISE = "use the MuJoCo engine for such a model, or take the element out"
SLIDE = 2  # mjtJoint.mjJNT_SLIDE
CLOSE = 1e-14  # entries of rotations that are this close to 0 or 1 are meant to be


def compile_tree(model: mujoco.MjModel, name: str) -> Tree:
    """Describe a model as a tree of hinges and slides.

    Args:
        model: Compiled model.
        name: Name for messages where the model has none.

    Raises:
        TreeError: The model has an element that a contact-free tree of hinges and slides cannot have.
    """
    import mujoco

    refuse_what_is_no_tree(model)
    names = _Names(model, mujoco)
    poses = _reference_poses(model)
    joints, last = _joints(model, names)
    bodies = _bodies(model, names, poses, last)
    if not joints:
        raise TreeError("the model has no joints: nothing in it can move")
    _refuse_massless(joints, bodies)
    sites = _sites(model, names, poses, last, bodies)
    actuators = _actuators(model, names)
    bare = not actuators
    if bare:
        actuators = tuple(_torque(joint, j) for j, joint in enumerate(joints))
    firsts = {own.joint: own for own in reversed(actuators)}.values()
    actuators = tuple(sorted(actuators, key=lambda own: own not in firsts))
    notes = [*_left_out(model, names, last), *names.notes]
    gravity = (
        np.zeros(3) if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY else model.opt.gravity
    )
    return Tree(
        _model_name(model) or name,
        tuple(joints),
        tuple(bodies),
        actuators,
        sites,
        _vector(gravity),
        tuple(notes),
        bare,
    )


def refuse_what_is_no_tree(model: mujoco.MjModel) -> None:
    """Refuse the elements whose physics a contact-free tree cannot have.

    Raises:
        TreeError: There is one; the message names it.
    """
    import mujoco

    def of(kind: Any, i: int) -> str:
        return mujoco.mj_id2name(model, kind, i) or f"number {i + 1}"

    types, kinds = mujoco.mjtJoint, mujoco.mjtObj
    for j in range(model.njnt):
        if (found := types(model.jnt_type[j])) in (types.mjJNT_FREE, types.mjJNT_BALL):
            kind = "free" if found == types.mjJNT_FREE else "ball"
            body = of(kinds.mjOBJ_BODY, model.jnt_bodyid[j])
            raise TreeError(
                f'the body "{body}" has a {kind} joint; a tree has hinges and slides: replace it by those, fix the '
                "body, or use the MuJoCo engine"
            )
    for e in range(model.neq):
        if model.eq_active0[e]:
            raise TreeError(f'the equality constraint "{of(kinds.mjOBJ_EQUALITY, e)}" is active; {OTHERWISE}')
    for t in range(model.ntendon):
        acts = (
            model.tendon_stiffness[t]
            or model.tendon_damping[t]
            or model.tendon_frictionloss[t]
            or model.tendon_armature[t]
            or model.tendon_limited[t]
            or any(
                int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_TENDON)
                and model.actuator_trnid[a, 0] == t
                for a in range(model.nu)
            )
        )
        if acts:
            raise TreeError(f'the tendon "{of(kinds.mjOBJ_TENDON, t)}" acts on joints; {OTHERWISE}')
    for b in range(model.nbody):
        if model.body_gravcomp[b]:
            raise TreeError(
                f'the body "{of(kinds.mjOBJ_BODY, b)}" has gravcomp; set it to 0, or use the MuJoCo engine'
            )
    if model.nflex or model.nplugin:
        raise TreeError(f"the model has a flexible body or a plugin; {OTHERWISE}")
    for values, what in (
        (model.jnt_stiffnesspoly, "stiffness"),
        (model.dof_dampingpoly, "damping"),
    ):
        for j in range(len(values)):
            if np.any(values[j]):
                raise TreeError(
                    f'the joint "{of(kinds.mjOBJ_JOINT, j)}" has a {what} that changes with the motion; give one '
                    "number, or use the MuJoCo engine"
                )


class _Names:
    """Names of joints, bodies, actuators and sites; what has none gets one, and signs that names lack are replaced."""

    def __init__(self, model: mujoco.MjModel, mujoco: Any) -> None:
        kinds = mujoco.mjtObj
        self.notes: list[str] = []

        def given(kind: Any, i: int) -> str:
            return mujoco.mj_id2name(model, kind, i) or ""

        bodies = [given(kinds.mjOBJ_BODY, b) or f"body {b}" for b in range(model.nbody)]
        self.bodies = self._readable(bodies, "body")
        joints = []
        for j in range(model.njnt):
            body = self.bodies[model.jnt_bodyid[j]]
            alone = model.body_jntnum[model.jnt_bodyid[j]] == 1
            number = j - model.body_jntadr[model.jnt_bodyid[j]] + 1
            joints.append(given(kinds.mjOBJ_JOINT, j) or (body if alone else f"{body} {number}"))
        self.joints = self._readable(joints, "joint")
        actuators = []
        for a in range(model.nu):
            driven = model.actuator_trnid[a, 0]
            actuators.append(given(kinds.mjOBJ_ACTUATOR, a) or self._free(self.joints[driven], actuators))
        self.actuators = self._readable(actuators, "actuator")
        sites = [given(kinds.mjOBJ_SITE, s) or f"site {s}" for s in range(model.nsite)]
        self.sites = self._readable(sites, "site")

    @staticmethod
    def _free(name: str, taken: Sequence[str]) -> str:
        number, free = 2, name
        while free in taken:
            free, number = f"{name} {number}", number + 1
        return free

    def _readable(self, names: list[str], kind: str) -> list[str]:
        result: list[str] = []
        for name in names:
            plain = "".join("_" if sign in UNREADABLE else sign for sign in name)
            unique = self._free(plain, result)
            if unique != name:
                self.notes.append(f'the {kind} "{name}" is called "{unique}" here')
            result.append(unique)
        return result


def _model_name(model: mujoco.MjModel) -> str:
    text = bytes(model.names).split(b"\0", 1)[0].decode()
    return "" if text == "MuJoCo Model" else text


def _reference_poses(model: mujoco.MjModel) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotation and place of each body's frame in its parent's."""
    return [(_rotation(model.body_quat[b]), np.array(model.body_pos[b])) for b in range(model.nbody)]


def _to_moving(
    model: mujoco.MjModel, body: int, poses: Sequence[tuple[np.ndarray, np.ndarray]]
) -> tuple[int, np.ndarray, np.ndarray]:
    """The body with joints that a body is welded to (0 for the world), and the body's frame in its frame."""
    rotation, place, at = np.eye(3), np.zeros(3), body
    while at and not model.body_jntnum[at]:
        own, offset = poses[at]
        rotation, place = own @ rotation, offset + own @ place
        at = int(model.body_parentid[at])
    return at, rotation, place


def _joint_frame(model: mujoco.MjModel, j: int) -> tuple[np.ndarray, np.ndarray]:
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


def _joints(model: mujoco.MjModel, names: _Names) -> tuple[list[Joint], dict[int, int]]:
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
                Frame(_matrix(before.T @ rotation), _vector(before.T @ (origin - place))),
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
    model: mujoco.MjModel,
    names: _Names,
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
        for _, own, centre, matrix in parts:
            arm = centre - com
            inertia += matrix + own * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        moments, axes = _principal(inertia, _rotation(model.body_iquat[b]), model.body_inertia[b], len(parts))
        rotation, origin = _joint_frame(model, last[b])
        frame = Frame(_matrix(rotation.T), _vector(-rotation.T @ origin))
        welded = tuple(part[0] for part in parts[1:] if part[1] > 0.0)
        result.append(
            Body(
                names.bodies[b],
                last[b],
                frame,
                float(mass),
                _vector(com),
                _matrix(axes),
                _vector(moments),
                welded,
            )
        )
    return result


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
        if not mass > 0.0 and not joint.armature > 0.0:
            raise TreeError(
                f'nothing behind the joint "{joint.name}" has a mass; give its body an <inertial> or a geom'
            )


def _sites(
    model: mujoco.MjModel,
    names: _Names,
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
        found.append(Site(names.sites[s], last[top], _vector(inner.T @ (at - origin))))
    taken = {site.name for site in found}
    for body in bodies:
        if body.name not in taken:
            at = np.array(body.frame.offset) + np.array(body.frame.rotation) @ np.array(body.com)
            found.append(Site(body.name, body.joint, _vector(at)))
    return tuple(found)


def _actuators(model: mujoco.MjModel, names: _Names) -> tuple[Actuator, ...]:
    import mujoco

    gains, biases, dynamics = mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtDyn
    on_joints = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    result = []
    for a in range(model.nu):
        where = f'the actuator "{names.actuators[a]}"'
        if mujoco.mjtTrn(model.actuator_trntype[a]) not in on_joints:
            raise TreeError(f"{where} does not drive a joint; {OTHERWISE}")
        if not model.actuator_gear[a, 0]:
            raise TreeError(
                f"{where} has the gear 0, so it moves nothing; give it another gear, or take it out"
            )
        scale, offset = gains(model.actuator_gaintype[a]), biases(model.actuator_biastype[a])
        if scale not in (gains.mjGAIN_FIXED, gains.mjGAIN_AFFINE) or (
            offset not in (biases.mjBIAS_NONE, biases.mjBIAS_AFFINE)
        ):
            raise TreeError(
                f"{where} is neither motor, position, velocity nor general with a fixed gain and an affine bias; "
                "replace it by one of these, or use the MuJoCo engine"
            )
        kind = dynamics(model.actuator_dyntype[a])
        filters = (dynamics.mjDYN_FILTER, dynamics.mjDYN_FILTEREXACT)
        if kind not in (dynamics.mjDYN_NONE, *filters) or model.actuator_ctrlnum[a] != 1:
            raise TreeError(
                f"{where} has dynamics other than a first-order filter; replace it, or use the MuJoCo engine"
            )
        if any(
            np.any(x[a])
            for x in (model.actuator_damping, model.actuator_armature, model.actuator_dampingpoly)
        ):
            raise TreeError(f"{where} has a damping or an armature; move it to the joint")
        affine = scale == gains.mjGAIN_AFFINE
        gain = model.actuator_gainprm[a, :3] * (1.0, affine, affine)
        biased = offset == biases.mjBIAS_AFFINE
        bias = model.actuator_biasprm[a, :3] * float(biased)
        low, high = model.actuator_ctrlrange[a] if model.actuator_ctrllimited[a] else (-np.inf, np.inf)
        forces = model.actuator_forcerange[a] if model.actuator_forcelimited[a] else (-np.inf, np.inf)
        if model.actuator_actlimited[a]:
            low, high = max(low, model.actuator_actrange[a, 0]), min(high, model.actuator_actrange[a, 1])
        lag = float(model.actuator_dynprm[a, 0]) if kind in filters else 0.0
        result.append(
            Actuator(
                names.actuators[a],
                int(model.actuator_trnid[a, 0]),
                float(model.actuator_gear[a, 0]),
                _vector(gain),
                _vector(bias),
                float(low),
                float(high),
                float(forces[0]),
                float(forces[1]),
                lag,
                _delay(model, a),
            )
        )
    return tuple(result)


def _delay(model: mujoco.MjModel, a: int) -> float:
    """Mean delay of a control [s]; MuJoCo's linear interpolation lets a jump begin one time step early."""
    delay = float(model.actuator_delay[a])
    linear = model.actuator_history[a, 1] == 1
    return max(delay - 0.5 * float(model.opt.timestep), 0.0) if linear and delay > 0.0 else delay


def _torque(joint: Joint, index: int) -> Actuator:
    """A command in N m or N, within the joint's own limits of effort."""
    low, high = joint.force_low, joint.force_high
    return Actuator(joint.name, index, 1.0, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), low, high, -np.inf, np.inf, 0.0)


def _left_out(model: mujoco.MjModel, names: _Names, last: dict[int, int]) -> list[str]:
    """Sentences on physics of the model that the tree leaves out."""
    notes = []
    if _may_collide(model):
        notes.append("contacts are not simulated, although geoms of the model can collide")
    limited = [names.joints[j] for j in range(model.njnt) if model.jnt_limited[j]]
    if limited:
        notes.append(f"limits of joints are not simulated: {', '.join(limited)}")
    if model.opt.density or model.opt.viscosity:
        notes.append("the drag of the medium (density, viscosity) is not simulated")
    return notes


def _may_collide(model: mujoco.MjModel) -> bool:
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


def _matrix(rotation: np.ndarray) -> Matrix:
    """Rows as floats; what differs from 0 or 1 by rounding only is made exact."""
    tidy = np.where(np.abs(rotation) < CLOSE, 0.0, rotation)
    tidy = np.where(np.abs(np.abs(tidy) - 1.0) < CLOSE, np.sign(tidy), tidy)
    a, b, c = (_vector(row) for row in tidy)
    return a, b, c


def _vector(values: np.ndarray) -> Vector:
    x, y, z = (float(v) + 0.0 for v in values)
    return x, y, z
