"""Elements of a model whose physics a contact-free tree of hinges and slides cannot have."""

from __future__ import annotations

from typing import Any

import numpy as np

from deepkoco.systems.trees.mujoco_library import Model, mujoco_library
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
    for j in range(model.njnt):
        if (found := types(model.jnt_type[j])) in (types.mjJNT_FREE, types.mjJNT_BALL):
            kind = "free" if found == types.mjJNT_FREE else "ball"
            body = of(kinds.mjOBJ_BODY, model.jnt_bodyid[j])
            raise TreeError(
                f'the body "{body}" has a {kind} joint; a tree has hinges and slides: replace it by those, fix the '
                "body, or use the MuJoCo engine"
            )
    for e in range(model.neq):
        if not model.eq_active0[e]:
            continue
        if mujoco.mjtEq(model.eq_type[e]) == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj2id[e] >= 0:
            one, other = (of(kinds.mjOBJ_JOINT, int(ids[e])) for ids in (model.eq_obj1id, model.eq_obj2id))
            raise TreeError(
                f'the joint "{one}" follows the joint "{other}" (<mimic>, or an equality of joints), and joints of a '
                f'tree are free; fix "{one}" to its parent, or use the MuJoCo engine'
            )
        else:
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
