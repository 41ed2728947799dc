"""The compiled loop behind the interface of a system: which calls it can take, and its arrays."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.motion import Motion
from deepkoco.systems.trees.dynamics import Inertia
from deepkoco.systems.trees.parameters import Law
from deepkoco.systems.trees.scalars import Scalar, Triple
from deepkoco.systems.trees.tree import Tree

PASSIVE = ("armature", "damping", "stiffness", "springref", "frictionloss")


class TreeArrays:
    """The numbers of a tree that no parameter changes."""

    def __init__(self, tree: Tree) -> None:
        joints, actuators = tree.joints, tree.actuators
        count = len(joints)
        self.parent = np.array([j.parent if j.parent >= 0 else count for j in joints], np.int64)
        self.turns = np.array([0.0 if j.slides else 1.0 for j in joints])
        self.rotation = np.array([np.ravel(j.frame.rotation) for j in joints])
        self.offset = np.array([j.frame.offset for j in joints])
        self.reference = np.array([j.reference for j in joints])
        self.limits = np.array([(j.force_low, j.force_high) for j in joints])
        self.drives = np.array([a.joint for a in actuators], np.int64)
        self.gear = np.array([a.gear for a in actuators])


class FastLaw:
    """The equations of motion under G sets of parameters, laid out for the compiled loop.

    Args:
        arrays: Numbers of the tree.
        inertias: Of each joint.
        gravity: In the base's frame.
        passive: For each of `PASSIVE` one value per joint.
        laws: Gain, bias and range of the force of each actuator.
    """

    def __init__(
        self,
        arrays: TreeArrays,
        inertias: Sequence[Inertia],
        gravity: Triple,
        passive: Sequence[Sequence[Scalar]],
        laws: Sequence[Law],
    ) -> None:
        self.arrays = arrays
        listed: list[Scalar] = [v for i in inertias for v in (i.mass, *i.first, *i.second)]
        listed += [*gravity]
        listed += [values[j] for j in range(len(inertias)) for values in passive]
        listed += [v for law in laws for v in (*law.gain, *law.bias, law.low, law.high)]
        self.shape = common_shape(v.shape for v in listed if isinstance(v, Tensor))
        groups = math.prod(self.shape)
        table = np.empty((len(listed), *self.shape))
        for row, value in enumerate(listed):
            table[row] = value.detach().numpy() if isinstance(value, Tensor) else value
        table = table.reshape(len(listed), groups)
        joints, ends = len(inertias), np.cumsum([10 * len(inertias), 3, len(passive) * len(inertias)])
        parts = np.split(table, ends)
        self.inertia = parts[0].reshape(joints, 10, groups)
        self.gravity = parts[1]
        self.passive = parts[2].reshape(joints, len(passive), groups)
        self.law = parts[3].reshape(-1, 8, groups)
        self.rubs = bool(self.passive[:, PASSIVE.index("frictionloss")].any())
        self._groups: dict[tuple[int, ...], np.ndarray] = {}

    def __call__(self, motion: Motion, smoothing: Sequence[float]) -> tuple[Tensor, ...]:
        """Accelerations of a motion without gradients.

        Args:
            motion: As for the system.
            smoothing: Speed of each joint over which the sign of dry friction changes where the motion gives none.
        """
        from deepkoco.systems.trees.kernel import tree_accelerations

        # The compiled loop does not check bounds.
        given = len(motion.angles), len(motion.speeds), len(motion.efforts)
        wanted = len(self.inertia), len(self.inertia), len(self.law)
        if given != wanted:
            raise ValueError(f"a motion has {given} angles, speeds and efforts; the robot has {wanted}")
        loads = [] if motion.loads is None else [x for x in motion.loads if x is not None]
        widths = motion.smoothing if motion.smoothing is not None else smoothing
        parts = [*motion.angles, *motion.speeds, *motion.efforts, *loads]
        shape = common_shape((self.shape, *(x.shape for x in parts)))
        count, joints = math.prod(shape), len(motion.angles)
        empty = np.empty((joints, 0))
        pushes, rubbing = empty, empty
        if loads:
            assert motion.loads is not None
            pushes = _rows([0.0 if x is None else x for x in motion.loads], shape, count)
        if self.rubs:
            rubbing = _rows(widths, shape, count)
        a = self.arrays
        result = np.empty((joints, count))
        tree_accelerations(
            a.parent, a.turns, a.rotation, a.offset, a.reference, a.limits, a.drives, a.gear,
            self._group(shape), self.inertia, self.gravity, self.passive, self.law,
            _rows(motion.angles, shape, count), _rows(motion.speeds, shape, count),
            _rows(motion.efforts, shape, count), pushes, rubbing, result,
        )  # fmt: skip
        return torch.from_numpy(result).view(joints, *shape).unbind(0)

    def inverse_inertia(self, angles: Sequence[Tensor]) -> tuple[tuple[Tensor, ...], ...]:
        """J rows of J columns of the inverse mass matrix at J angles (...) [1/(kg m2) or 1/kg]."""
        from deepkoco.systems.trees.kernel import tree_inverse_inertia

        shape = common_shape((self.shape, *(x.shape for x in angles)))
        count, joints, a = math.prod(shape), len(angles), self.arrays
        result = np.empty((joints, joints, count))
        tree_inverse_inertia(
            a.parent, a.turns, a.rotation, a.offset, a.reference, self._group(shape), self.inertia, self.passive,
            _rows(angles, shape, count), result,
        )  # fmt: skip
        table = torch.from_numpy(result).view(joints, joints, *shape)
        return tuple(row.unbind(0) for row in table.unbind(0))

    def _group(self, shape: tuple[int, ...]) -> np.ndarray:
        """Index of the parameters of each element of a batch."""
        if shape not in self._groups:
            own = np.arange(math.prod(self.shape)).reshape(self.shape)
            # A copy: the loop is compiled again for arrays that cannot be written.
            self._groups[shape] = np.array(np.broadcast_to(own, shape)).ravel()
        return self._groups[shape]


def common_shape(shapes: Iterable[tuple[int, ...]]) -> tuple[int, ...]:
    """Shape to which all broadcast; torch's own function takes a hundred times as long."""
    distinct = {tuple(shape) for shape in shapes}
    return next(iter(distinct)) if len(distinct) == 1 else np.broadcast_shapes(*distinct)


def _rows(values: Sequence[Tensor | float], shape: tuple[int, ...], count: int) -> np.ndarray:
    """(n, count) values of n signals in one array."""
    table = np.empty((len(values), *shape))
    for row, value in enumerate(values):
        table[row] = value.detach().numpy() if isinstance(value, Tensor) else value
    return table.reshape(len(values), count)
