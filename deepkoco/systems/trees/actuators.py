"""Actuators of a model that a tree can have: motors and servos on joints."""

from __future__ import annotations

import numpy as np

from deepkoco.systems.trees.mujoco_library import Model, mujoco_library
from deepkoco.systems.trees.names import Names
from deepkoco.systems.trees.refusals import OTHERWISE
from deepkoco.systems.trees.tree import Actuator, Joint, TreeError, vector


def read_actuators(model: Model, names: Names) -> tuple[Actuator, ...]:
    """Actuators of a model, in its order.

    Raises:
        TreeError: One is neither a motor nor a servo on a joint; the message names it.
    """
    mujoco = mujoco_library()

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
                vector(gain),
                vector(bias),
                float(low),
                float(high),
                float(forces[0]),
                float(forces[1]),
                lag,
                _delay(model, a),
            )
        )
    return tuple(result)


def _delay(model: Model, a: int) -> float:
    """Mean delay of a control [s]; MuJoCo's linear interpolation lets a jump begin one time step early."""
    delay = float(model.actuator_delay[a])
    linear = model.actuator_history[a, 1] == 1
    return max(delay - 0.5 * float(model.opt.timestep), 0.0) if linear and delay > 0.0 else delay


def load_actuator(joint: Joint, index: int) -> Actuator:
    """A command in N m or N, within the joint's own limits of effort."""
    low, high = joint.force_low, joint.force_high
    return Actuator(joint.name, index, 1.0, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), low, high, -np.inf, np.inf, 0.0)
