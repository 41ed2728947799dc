"""The fastest motions of a tree: the step that follows them, and what keeps those that no log shows from being faster.

A damping of 1 N m s/rad at a wrist of 1e-4 kg m2 fades within 0.1 ms. An explicit method would need steps of that size
for a motion that no sensor sees. Simulations therefore add so much armature to such a joint that its motion fades at
`FASTEST`, or swings at `FASTEST_SWING`: what is slower than that hardly changes, because there the damping or the
spring decides, not the inertia.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.trees.dynamics import bias_forces, inverse_mass, mass_matrix
from deepkoco.systems.trees.parameters import Law, link_inertias
from deepkoco.systems.trees.scalars import Scalar, add, mul
from deepkoco.systems.trees.scales import random_poses
from deepkoco.systems.trees.tree import Actuator, Tree, TreeError

SWING = 0.5  # turn of the fastest swinging motion in one integration step [rad]: 5e-4 rad of phase error
# Decay of the fastest motion, and turn of a swing that no log shows, in one step. The Runge-Kutta method is stable to
# 2.78. A log shows no error of a decay within a few milliseconds: commands that jump inside a step leave larger ones.
STABLE = 1.9
LARGEST = 2.5  # the same where a fit changes the parameters
REDUNDANT = (
    1e-10  # smallest eigenvalue of an inertia matrix with a diagonal of ones, below which it is singular
)
FASTEST, FASTEST_SWING = 1000.0, 500.0  # [1/s, rad/s]
# Smallest swing in which a servo is followed [rad, m]. What a drive of limited force exerts there bounds
# the stiffness that a step must follow: a drive that is cut off before pulls with its limit, not with its stiffness.
SEEN_TURN, SEEN_WAY = 0.05, 0.005


def refuse_redundant(tree: Tree, where: str) -> None:
    """Refuse joints that move the same bodies in the same way in every pose: nothing tells their motions apart.

    Args:
        tree: The tree.
        where: Named in the message.

    Raises:
        TreeError: There are such joints; the message names them.
    """
    poses, count = random_poses(tree), len(tree.joints)
    armatures = [joint.armature for joint in tree.joints]
    mass = np.zeros((len(poses[0]), count, count))
    for j, row in enumerate(mass_matrix(tree.joints, link_inertias(tree, {}), armatures, poses)):
        for k, entry in enumerate(row):
            mass[:, j, k] = mass[:, k, j] = torch.as_tensor(entry).numpy()
    size = np.sqrt(np.maximum(np.einsum("njj->nj", mass), 1e-300))
    values, vectors = np.linalg.eigh(mass / (size[:, :, None] * size[:, None, :]))
    best = int(values[:, 0].argmax())
    if values[best, 0] > REDUNDANT:
        return
    share = np.abs(vectors[best, :, 0])
    names = [joint.name for joint, own in zip(tree.joints, share, strict=True) if own > 0.1 * share.max()]
    raise TreeError(
        f"{where}: the joints {', '.join(names)} move the same bodies in the same way, so nothing tells their "
        "motions apart; leave one out, or give it an armature"
    )


def least_inertias(tree: Tree) -> tuple[float, ...]:
    """Smallest inertia [kg m2 or kg] that each joint moves, over random poses, while all others are free."""
    inverse = _inverses(tree, [joint.armature for joint in tree.joints])
    return tuple(1.0 / float(inverse[:, j, j].max()) for j in range(len(tree.joints)))


def added_armatures(
    actuators: Sequence[Actuator],
    least: Sequence[float],
    passive: Mapping[str, Sequence[Scalar]],
    laws: Sequence[Law],
    step: float = 0.0,
) -> list[Scalar]:
    """Armature of each joint [kg m2 or kg] that keeps its motion at `FASTEST` and `FASTEST_SWING`; mostly 0.

    Args:
        actuators: Of the tree.
        least: As of :func:`least_inertias`.
        passive: Damping and stiffness of each joint.
        laws: Gain and bias of each actuator.
        step: Integration step [s] that must stay stable under these values.
    """
    fastest = min(FASTEST, LARGEST / max(step, 1e-9))
    swing = min(FASTEST_SWING, LARGEST / max(step, 1e-9))
    dampings, springs = resistances(actuators, passive, laws)
    result: list[Scalar] = []
    for own, damping, spring in zip(least, dampings, springs, strict=True):
        needed = larger(mul(1.0 / fastest, damping), mul(swing**-2, spring))
        result.append(larger(add(needed, -own), 0.0))
    return result


def resistances(
    actuators: Sequence[Actuator], passive: Mapping[str, Sequence[Scalar]], laws: Sequence[Law]
) -> tuple[list[Scalar], list[Scalar]]:
    """Damping [N m s/rad or N s/m] and stiffness [N m/rad or N/m] of each joint, with those of its servos."""
    dampings, springs = list(passive["damping"]), list(passive["stiffness"])
    for actuator, (gain, bias, _, _) in zip(actuators, laws, strict=True):
        j, square = actuator.joint, actuator.gear**2
        control = max(abs(actuator.low), abs(actuator.high))
        for kind, i in ((springs, 1), (dampings, 2)):
            size = _size(bias[i])
            if math.isfinite(control):
                size = add(size, mul(control, _size(gain[i])))
            kind[j] = add(kind[j], mul(square, size))
    return dampings, springs


def longest_step(tree: Tree, armatures: Sequence[float], laws: Sequence[Law]) -> float:
    """Longest Runge-Kutta step [s] for the fastest small motion of a tree, over random poses.

    The motion about a pose is M q'' + D q' + K q = 0, with the springs and the servos in K and D. Where the imaginary
    part of an eigenvalue is the larger one the motion swings, and a step turns it by at most `SWING`. Else it fades,
    and a step must only be stable. Where the force of a servo is limited, its stiffness counts up to what it exerts in
    a swing of `SEEN_TURN`; in smaller swings a step must only be stable too.

    Args:
        tree: The tree.
        armatures: Of each joint, with what is added.
        laws: Gain and bias of each actuator.
    """
    passive = {kind: [getattr(joint, kind) for joint in tree.joints] for kind in ("damping", "stiffness")}
    inverse, weights = _inverses(tree, armatures), _weights(tree)
    damping, full = (np.array(x, dtype=float) for x in resistances(tree.actuators, passive, laws))
    shown = np.minimum(full, np.array(passive["stiffness"], dtype=float) + _limits(tree))
    values = _small_motions(inverse, damping, shown + weights)
    swings = np.abs(np.imag(values)) > np.abs(np.real(values))
    turn = float(np.abs(values[swings]).max(initial=0.0)) / SWING
    fastest = np.abs(_small_motions(inverse, damping, full + weights))
    return 1.0 / max(turn, float(fastest.max(initial=0.0)) / STABLE, 1e-3)


def _small_motions(inverse: np.ndarray, damping: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Eigenvalues [1/s] of the small motions about each pose."""
    size = inverse.shape[-1]
    matrix = np.zeros((len(inverse), 2 * size, 2 * size))
    matrix[:, :size, size:] = np.eye(size)
    matrix[:, size:, :size] = -inverse * stiffness
    matrix[:, size:, size:] = -inverse * damping
    return np.linalg.eigvals(matrix)


def _limits(tree: Tree) -> np.ndarray:
    """(J,) largest stiffness that servos show in a swing that a log shows [N m/rad or N/m]."""
    result = np.zeros(len(tree.joints))
    for actuator in tree.actuators:
        seen = SEEN_WAY if tree.joints[actuator.joint].slides else SEEN_TURN
        most = max(abs(actuator.force_low), abs(actuator.force_high))
        result[actuator.joint] += abs(actuator.gear) * most / seen
    for j, joint in enumerate(tree.joints):
        seen = SEEN_WAY if joint.slides else SEEN_TURN
        result[j] = min(result[j], max(abs(joint.force_low), abs(joint.force_high)) / seen)
    return result


def _inverses(tree: Tree, armatures: Sequence[float]) -> np.ndarray:
    """(n, J, J) inverse mass matrices over random poses."""
    poses = random_poses(tree)
    rows = inverse_mass(tree.joints, link_inertias(tree, {}), armatures, poses)
    return torch.stack([torch.stack(row, -1) for row in rows], -2).numpy()


def _weights(tree: Tree) -> np.ndarray:
    """(J,) largest stiffness that gravity gives a joint [N m/rad]: at most its largest torque."""
    poses = random_poses(tree)
    still = [torch.zeros_like(poses[0])] * len(tree.joints)
    torques = bias_forces(tree.joints, link_inertias(tree, {}), tree.gravity, poses, still)
    sizes = [float(torch.as_tensor(_size(torque)).max()) for torque in torques]
    return np.array([0.0 if j.slides else size for j, size in zip(tree.joints, sizes, strict=True)])


def _size(x: Scalar) -> Scalar:
    return abs(x)


def larger(a: Scalar, b: Scalar) -> Scalar:
    if not isinstance(a, Tensor):
        a, b = b, a
    if not isinstance(a, Tensor):
        return max(a, b)
    return torch.maximum(a, b) if isinstance(b, Tensor) else a.clamp(min=b)
