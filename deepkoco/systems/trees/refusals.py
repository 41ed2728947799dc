"""Elements of a model whose physics a contact-free tree of hinges and slides cannot have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepkoco.systems.trees.held_joints import how_to_hold
from deepkoco.systems.trees.mujoco_library import Model, mujoco_library
from deepkoco.systems.trees.names import Names
from deepkoco.systems.trees.tree import TreeError

OTHERWISE = "use the MuJoCo engine for such a model, or take the element out"


def refuse_what_is_no_tree(model: Model) -> None:
    """Refuse the elements whose physics a contact-free tree cannot have.

    Raises:
        TreeError: There is one; the message names it.
    """
    mujoco = mujoco_library()

    def of(kind: Any, i: int) -> str:
        return mujoco.mj_id2name(model, kind, i) or f"number {i + 1}"

    types, kinds = mujoco.mjtJoint, mujoco.mjtObj
    joints = Names(model).joints
    for j in range(model.njnt):
        if (found := types(model.jnt_type[j])) in (types.mjJNT_FREE, types.mjJNT_BALL):
            kind = "free" if found == types.mjJNT_FREE else "ball"
            body = of(kinds.mjOBJ_BODY, model.jnt_bodyid[j])
            raise TreeError(
                f'the body "{body}" has a {kind} joint, "{joints[j]}"; a tree has hinges and slides. Where it stands '
                f"still in the logs, hold it: {how_to_hold([joints[j]])}; otherwise use the MuJoCo engine"
            )
    for e in range(model.neq):
        moved = _joints_between(model, _bodies_of_equality(model, e))
        if model.eq_active0[e] and moved:
            raise TreeError(
                f'the equality constraint "{of(kinds.mjOBJ_EQUALITY, e)}" is active. Where the joints that it ties '
                f"stand still in the logs, hold them: {how_to_hold([joints[j] for j in moved])}; otherwise {OTHERWISE}"
            )
    for t in range(model.ntendon):
        acts = (
            model.tendon_stiffness[t]
            or model.tendon_damping[t]
            or model.tendon_frictionloss[t]
            or model.tendon_armature[t]
            or any(
                int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_TENDON)
                and model.actuator_trnid[a, 0] == t
                for a in range(model.nu)
            )
        )
        moved = _joints_of_tendon(model, t)
        if acts and moved:
            raise TreeError(
                f'the tendon "{of(kinds.mjOBJ_TENDON, t)}" acts on joints. Where these stand still in the logs, hold '
                f"them: {how_to_hold([joints[j] for j in moved])}; otherwise {OTHERWISE}"
            )
    for j in range(model.njnt):
        if model.jnt_actgravcomp[j]:
            raise TreeError(
                f'the joint "{of(kinds.mjOBJ_JOINT, j)}" has actuatorgravcomp; set it to "false": its bodies are then '
                "held up without the limits of the actuator"
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


def _joints_between(model: Model, bodies: Sequence[int]) -> list[int]:
    """Joints that move some of these bodies, but not all of them alike."""
    above = [_joints_above(model, body) for body in bodies]
    return sorted(set().union(*above) - set.intersection(*above)) if above else []


def _joints_above(model: Model, body: int) -> set[int]:
    found: set[int] = set()
    while body:
        found |= set(range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]))
        body = int(model.body_parentid[body])
    return found


def _bodies_of_equality(model: Model, e: int) -> list[int]:
    """Bodies that an equality ties; of one between joints or tendons, those at both ends of each joint."""
    kinds, equalities = mujoco_library().mjtObj, mujoco_library().mjtEq
    ends = [int(ids[e]) for ids in (model.eq_obj1id, model.eq_obj2id) if ids[e] >= 0]
    kind = equalities(model.eq_type[e])
    if kind == equalities.mjEQ_JOINT:
        joints = ends
    elif kind == equalities.mjEQ_TENDON:
        joints = [j for t in ends for j in _joints_of_tendon(model, t)]
    else:
        if kinds(model.eq_objtype[e]) == kinds.mjOBJ_SITE:
            ends = [int(model.site_bodyid[s]) for s in ends]
        return ends if len(ends) > 1 else [*ends, 0]
    bodies = [int(model.jnt_bodyid[j]) for j in joints]
    return [*bodies, *(int(model.body_parentid[b]) for b in bodies)]


def _joints_of_tendon(model: Model, t: int) -> list[int]:
    """Joints whose motion changes the length of a tendon."""
    mujoco = mujoco_library()
    wraps = range(model.tendon_adr[t], model.tendon_adr[t] + model.tendon_num[t])
    bodies = []
    for w in wraps:
        kind, i = mujoco.mjtWrap(model.wrap_type[w]), int(model.wrap_objid[w])
        if kind == mujoco.mjtWrap.mjWRAP_JOINT:
            bodies += [int(model.jnt_bodyid[i]), int(model.body_parentid[model.jnt_bodyid[i]])]
        elif kind == mujoco.mjtWrap.mjWRAP_SITE:
            bodies.append(int(model.site_bodyid[i]))
        elif kind in (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER):
            bodies.append(int(model.geom_bodyid[i]))
    return _joints_between(model, bodies)
