"""Parameters of a MuJoCo model by name: ``mass(BODY)``, ``damping(JOINT)``, ``kp(ACTUATOR)`` and the like."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from itertools import permutations
from typing import Any

import numpy as np

from deepkoco.engines.engine import EngineError
from deepkoco.engines.mujoco_world import import_mujoco
from deepkoco.suggestion import did_you_mean

AXES = ("x", "y", "z")
_NAME = re.compile(r"(?P<kind>\w+)\((?P<of>.*)\)")
_OF_DOF = {"damping": "dof_damping", "frictionloss": "dof_frictionloss", "armature": "dof_armature"}
_OF_ACTUATOR = ("gain", "kp", "kv")


def parameter_values(model: Any) -> dict[str, float]:
    """Every parameter of a compiled model that can be changed, with its value.

    Masses [kg], centres of mass [m] and principal moments [kg m2] of the bodies in their own frames; of joints with one
    degree of freedom damping, dry friction, armature, stiffness and the rest position of the spring; of actuators
    ``gain``, or ``kp`` and ``kv`` of a servo; ``friction(GEOM)``, the sliding friction of a contact.
    """
    mujoco = import_mujoco()
    found: dict[str, float] = {}
    for b in range(1, model.nbody):
        name = model.body(b).name
        if name and model.body_mass[b] > 0.0:
            found[f"mass({name})"] = float(model.body_mass[b])
            for i, axis in enumerate(AXES):
                found[f"com_{axis}({name})"] = float(model.body_ipos[b, i])
            for i, axis in enumerate(AXES):
                found[f"inertia_{axis}({name})"] = float(model.body_inertia[b, _principal(model, b)[i]])
    kinds = {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}
    for j in range(model.njnt):
        name = model.joint(j).name
        if name and int(model.jnt_type[j]) in kinds:
            for kind, field in _OF_DOF.items():
                found[f"{kind}({name})"] = float(getattr(model, field)[model.jnt_dofadr[j]])
            found[f"stiffness({name})"] = float(model.jnt_stiffness[j])
            found[f"springref({name})"] = float(model.qpos_spring[model.jnt_qposadr[j]])
    for a in range(model.nu):
        name = model.actuator(a).name
        if not name:
            continue
        servo = _is_servo(model, a)
        found[f"{'kp' if servo else 'gain'}({name})"] = float(model.actuator_gainprm[a, 0])
        if servo:
            found[f"kv({name})"] = float(-model.actuator_biasprm[a, 2])
    for g in range(model.ngeom):
        if name := model.geom(g).name:
            found[f"friction({name})"] = float(model.geom_friction[g, 0])
    return found


def changed_model(model: Any, values: Mapping[str, float]) -> Any:
    """A copy of a compiled model with other values of some parameters.

    Args:
        model: Compiled model.
        values: By name, as in `parameter_values`.

    Raises:
        EngineError: The model has no such parameter.
    """
    mujoco = import_mujoco()
    changed = copy.copy(model)
    for name, value in values.items():
        _put(changed, name, value)
    mujoco.mj_setConst(changed, mujoco.MjData(changed))
    return changed


def check_names(model: Any, names: Mapping[str, Any] | list[str]) -> None:
    """Check that names are those of parameters.

    Raises:
        EngineError: One is not; the message proposes what may be meant.
    """
    known: dict[str, float] | None = None
    for name in names:
        known = parameter_values(model) if known is None else known
        if name not in known:
            raise EngineError(f'the MuJoCo model has no parameter "{name}"{did_you_mean(name, list(known))}')


def _put(model: Any, name: str, value: float) -> None:
    found = _NAME.fullmatch(name)
    assert found is not None, name
    kind, of = found["kind"], found["of"]
    if kind in _OF_ACTUATOR:
        a = model.actuator(of).id
        if kind in ("gain", "kp"):
            model.actuator_gainprm[a, 0] = value
        if kind == "kp":
            model.actuator_biasprm[a, 1] = -value
        if kind == "kv":
            model.actuator_biasprm[a, 2] = -value
    elif kind in _OF_DOF:
        getattr(model, _OF_DOF[kind])[model.jnt_dofadr[model.joint(of).id]] = value
    elif kind == "stiffness":
        model.jnt_stiffness[model.joint(of).id] = value
    elif kind == "springref":
        model.qpos_spring[model.jnt_qposadr[model.joint(of).id]] = value
    elif kind == "friction":
        model.geom_friction[model.geom(of).id, 0] = value
    else:
        b = model.body(of).id
        if kind == "mass":
            model.body_mass[b] = value
        elif kind.startswith("com_"):
            model.body_ipos[b, AXES.index(kind[-1])] = value
        else:
            model.body_inertia[b, _principal(model, b)[AXES.index(kind[-1])]] = value


def _is_servo(model: Any, actuator: int) -> bool:
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    return bool(gain[0] != 0.0 and bias[1] == -gain[0])


def _principal(model: Any, body: int) -> tuple[int, ...]:
    """Which principal moment belongs to the axis next to x, y and z of the body's frame."""
    mujoco = import_mujoco()
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, model.body_iquat[body])
    share = np.abs(matrix.reshape(3, 3))
    return max(permutations(range(3)), key=lambda order: sum(share[i, order[i]] for i in range(3)))
