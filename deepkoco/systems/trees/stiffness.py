"""The fastest motions of a tree: the step that follows them, and what keeps those that no log shows from being faster.

A damping of 1 N m s/rad at a wrist of 1e-4 kg m2 fades within 0.1 ms. An explicit method would need steps of that size
for a motion that no sensor sees. Simulations therefore add so much armature to such a joint that its motion fades at
`FASTEST`, or swings at `FASTEST_SWING`: what is slower than that hardly changes, because there the damping or the
spring decides, not the inertia.

What a log shows depends on its rate too. A position servo of 1600 N m/rad on a light arm without armature swings at 500
rad/s; a log of 11 Hz sees its 14 half turns from one sample to the next as one number, and only that the arm stands
where the servo holds it. :class:`Pace` says what a log of some rate shows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

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
# Turn in one step that the Runge-Kutta method takes away most of: x = 2.2 leaves (1 - x^6 / 72 + x^8 / 576)^(1/2) =
# 0.61 of a swing; slower and faster ones last longer. In twelve steps 0.3 % is left, and a whole turn is one of twelve
# times `SWING`.
FADING, FADED = 2.2, 12
# Share of the critical damping that a swing too fast for a log gets: it then overshoots by 4 %. Without a damping, the
# place at which dry friction ends a swing depends on each of its turns, and no slope of a fit knows them.
CALM = 0.7
# Share of a swing that may be left at the next sample, where the log shows nothing of it.
OVER = 0.01
REDUNDANT = (
    1e-10  # smallest eigenvalue of an inertia matrix with a diagonal of ones, below which it is singular
)
FASTEST, FASTEST_SWING = 1000.0, 500.0  # [1/s, rad/s]
LONGEST_STEP = 0.01  # of a fit [s]; see deepkoco.fit.data.windows
# Smallest swing in which a servo is followed [rad, m]. What a drive of limited force exerts there bounds
# the stiffness that a step must follow: a drive that is cut off before pulls with its limit, not with its stiffness.
SEEN_TURN, SEEN_WAY = 0.05, 0.005


class Pace(NamedTuple):
    """The fastest motions that simulations follow.

    Attributes:
        decay: Fastest decay [1/s]; added armature slows a faster one down to it.
        swing: Fastest swing [rad/s], in the same way.
        shown: Fastest swing that a log shows [rad/s]: a step turns it by at most `SWING`. Faster swings must be stable.
    """

    decay: float = FASTEST
    swing: float = FASTEST_SWING
    shown: float = math.inf


USUAL = Pace()


def pace_of(interval: float) -> tuple[Pace, float]:
    """Pace that suits logs of some rate, and the longest step [s] with which it is followed.

    Samples tell a swing from a slower one up to half a turn from one to the next; up to a whole turn it is followed. A
    faster one shows only where the joint is once it is over. It is slowed down to `FADING` a step, and ends within a
    sample.

    Args:
        interval: Time from one sample to the next [s].

    Source: Shannon, Communication in the presence of noise (1949), for the half turn.
    """
    step = min(interval / FADED, LONGEST_STEP)
    pace = Pace(min(FASTEST, STABLE / step), min(FASTEST_SWING, FADING / step), 2.0 * math.pi / interval)
    return pace, step


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
    pace: Pace = USUAL,
) -> list[Scalar]:
    """Armature of each joint [kg m2 or kg] that keeps its motion at the pace that simulations follow; mostly 0.

    Args:
        actuators: Of the tree.
        least: As of :func:`least_inertias`.
        passive: Damping and stiffness of each joint.
        laws: Gain and bias of each actuator.
        step: Integration step [s] that must stay stable under these values.
        pace: Fastest motions that are followed.
    """
    fastest = min(pace.decay, LARGEST / max(step, 1e-9))
    swing = min(pace.swing, LARGEST / max(step, 1e-9))
    dampings, springs = resistances(actuators, passive, laws)
    result: list[Scalar] = []
    for own, damping, spring in zip(least, dampings, springs, strict=True):
        needed = _larger(mul(1.0 / fastest, damping), mul(swing**-2, spring))
        result.append(_larger(add(needed, -own), 0.0))
    return result


def added_dampings(
    actuators: Sequence[Actuator],
    inertias: Sequence[Scalar],
    passive: Mapping[str, Sequence[Scalar]],
    laws: Sequence[Law],
    shown: float,
) -> list[Scalar]:
    """Damping of each joint [N m s/rad or N s/m] that ends swings which are too fast for a log; mostly 0.

    A swing of w rad/s gets the damping ratio `CALM`, and of w between ``shown`` and twice it a part of that. Goals that
    move evenly are then followed 2 `CALM` / w later, a small part of a sample.

    Args:
        actuators: Of the tree.
        inertias: Of each joint, with what simulations add [kg m2 or kg].
        passive: Damping and stiffness of each joint.
        laws: Gain and bias of each actuator.
        shown: Fastest swing that a log shows [rad/s].
    """
    result: list[Scalar] = []
    for inertia, damping, spring in zip(inertias, *resistances(actuators, passive, laws), strict=True):
        whole = mul(spring, inertia) ** 0.5
        swing = (spring / inertia) ** 0.5
        part = _larger(0.0, add(1.0, mul(-1.0, _larger(0.0, add(2.0, mul(-1.0 / shown, swing))))))
        result.append(_larger(add(mul(2.0 * CALM, mul(part, whole)), mul(-1.0, damping)), 0.0))
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


def longest_step(
    tree: Tree,
    armatures: Sequence[float],
    laws: Sequence[Law],
    shown: float = math.inf,
    dampings: Sequence[float] | None = None,
) -> float:
    """Longest Runge-Kutta step [s] for the fastest small motion of a tree, over random poses.

    The motion about a pose is M q'' + D q' + K q = 0, with the springs and the servos in K and D. Where the imaginary
    part of an eigenvalue is the larger one the motion swings, and a step turns it by at most `SWING`. Else it fades,
    and a step must only be stable. Where the force of a servo is limited, its stiffness counts up to what it exerts in
    a swing of `SEEN_TURN`; in smaller swings, and in those that are too fast for a log, a step must only be stable too.

    Args:
        tree: The tree.
        armatures: Of each joint, with what is added.
        laws: Gain and bias of each actuator.
        shown: Fastest swing that a log shows [rad/s].
        dampings: Of each joint, with what is added; None adds nothing.
    """
    passive = {kind: [getattr(joint, kind) for joint in tree.joints] for kind in ("damping", "stiffness")}
    if dampings is not None:
        passive["damping"] = list(dampings)
    inverse, weights = _inverses(tree, armatures), _weights(tree)
    damping, full = (np.array(x, dtype=float) for x in resistances(tree.actuators, passive, laws))
    seen = np.minimum(full, np.array(passive["stiffness"], dtype=float) + _limits(tree))
    turn = float(np.abs(_swings(_small_motions(inverse, damping, seen + weights), shown)[0]).max(initial=0.0))
    swings, others = _swings(_small_motions(inverse, damping, full + weights), math.inf)
    most = STABLE if math.isinf(shown) else FADING
    fastest = max(
        float(np.abs(swings).max(initial=0.0)) / most, float(np.abs(others).max(initial=0.0)) / STABLE
    )
    return 1.0 / max(turn / SWING, fastest, 1e-3)


def settles_within(
    tree: Tree,
    armatures: Sequence[float],
    laws: Sequence[Law],
    jumps: Sequence[float],
    interval: float,
    shown: float,
) -> bool:
    """Return whether swings of more than ``shown`` [rad/s] are over by the next sample of a log.

    That a swing is too fast to be followed by samples does not hide it: what is left of it at a sample is measured, and
    its decay with it. So it must end by itself, by damping to `OVER` of its size over random poses, or by dry friction:
    a friction F takes 2 F / K from a swing about the stiffness K in each of its half turns. That must be more than the
    swing after the largest jump of the commands, and than one of `SEEN_TURN`.

    Args:
        tree: The tree.
        armatures: Of each joint, with what is added.
        laws: Gain and bias of each actuator.
        jumps: Largest change of each command from one value to the next.
        interval: Time from one sample to the next [s].
        shown: Fastest swing that is followed [rad/s].

    Source: Den Hartog, Mechanical Vibrations (1956), sec. 8.3, for dry friction.
    """
    passive = {kind: [getattr(joint, kind) for joint in tree.joints] for kind in ("damping", "stiffness")}
    inverse = _inverses(tree, armatures)
    damping, stiffness = (np.array(x, dtype=float) for x in resistances(tree.actuators, passive, laws))
    values = _small_motions(inverse, damping, stiffness + _weights(tree))
    fast = (np.abs(np.imag(values)) > np.abs(np.real(values))) & (np.abs(values) > shown)
    if (np.exp(np.real(values[fast]) * interval) <= OVER).all():
        return True
    own = np.sqrt(stiffness * np.einsum("njj->nj", inverse).max(axis=0))
    half_turns = own * interval / math.pi
    friction = np.array([joint.frictionloss for joint in tree.joints])
    struck = stiffness * np.array([SEEN_WAY if joint.slides else SEEN_TURN for joint in tree.joints])
    for actuator, (gain, *_), jump in zip(tree.actuators, laws, jumps, strict=True):
        struck[actuator.joint] += abs(float(gain[0]) * actuator.gear) * jump
    ends = half_turns * 2.0 * friction >= struck
    return bool((ends | (own <= shown)).all())


def _swings(values: np.ndarray, shown: float) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues [1/s] of the swings that a log shows, and all others."""
    swings = (np.abs(np.imag(values)) > np.abs(np.real(values))) & (np.abs(values) <= shown)
    return values[swings], values[~swings]


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


def _larger(a: Scalar, b: Scalar) -> Scalar:
    if not isinstance(a, Tensor):
        a, b = b, a
    if not isinstance(a, Tensor):
        return max(a, b)
    return torch.maximum(a, b) if isinstance(b, Tensor) else a.clamp(min=b)
