"""Simulations of a tree along logs: the arrays of the compiled loop, and which calls it can take."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.dry_friction import CLOSE, SWEEPS, creep_table
from deepkoco.systems.effects.learned import TERMS
from deepkoco.systems.plain import is_plain
from deepkoco.systems.rollout import EffectLoad, RolloutInput, RolloutResult
from deepkoco.systems.trees.fast import FastLaw, common_shape
from deepkoco.systems.trees.outside_forces import force_parts, force_table
from deepkoco.systems.trees.tree import OutsideForce

KINDS = (
    "viscous",
    "quadratic",
    "asymmetric_viscous",
    "spring",
    "cogging",
    "periodic",
    "crosstalk",
    "torque_speed_curve",
    "stribeck",
    "load_friction",
)
"""Effects whose loads the loop knows, in the order of its constants."""
LEARNED = "learned"
KNOWN = {kind: k for k, kind in enumerate((*KINDS, *(f"{LEARNED}.{term}" for term in TERMS)))}


def is_known(kind: str) -> bool:
    """Whether the loop can add the loads of effects of this name."""
    return kind in KINDS or kind in ("constant_load", LEARNED)


class TreeRollout:
    """A tree under G sets of parameters, with loads of effects.

    Args:
        law: Its equations of motion without dry friction.
        forces: Outside forces.
        loads: Loads of effects.
        late: Time by which the speeds in all loads are late, as in an engine [s].
        impulsive: Whether steps are semi-implicit ones, with friction as an impulse of each.
    """

    def __init__(
        self,
        law: FastLaw,
        forces: Sequence[OutsideForce] = (),
        loads: Sequence[EffectLoad] = (),
        late: float = 0.0,
        impulsive: bool = False,
    ) -> None:
        self._law, self._forces, self._loads = law, tuple(forces), tuple(loads)
        self._late, self._impulsive = late, impulsive

    def knows(self, kind: str) -> bool:
        """Whether the loop can add the loads of effects of this name."""
        return is_known(kind)

    def with_loads(self, loads: Sequence[EffectLoad]) -> TreeRollout | None:
        """The same with loads of effects; None where their values are no plain numbers."""
        if not is_plain([v for load in loads for v in load.values]):
            return None
        known = (own for load in loads for own in _as_known(load))
        return TreeRollout(self._law, self._forces, (*self._loads, *known), self._late, self._impulsive)

    def run(self, given: RolloutInput) -> RolloutResult | None:
        """Simulate; None where a tensor is no plain number."""
        from deepkoco.systems.trees.effect_kernel import MOST_VALUES
        from deepkoco.systems.trees.rollout_kernel import tree_rollout

        soft = [creep.inertia for creep in given.friction.creeps or ()] + [*(given.friction.ahead or ())]
        tensors = [*given.start, *given.begin, *given.slope, given.loads, *given.friction.steady, *soft]
        if not is_plain(tensors):
            return None
        law, joints = self._law, len(given.start) // 2
        drives = [*given.begin, *given.slope, *([] if given.length is None else [given.length])]
        total, windows, lanes = given.begin[0].shape if given.begin else (0, 0, 0)
        steps = total // given.pieces
        listed = [v for load in self._loads for v in load.values]
        levels = given.friction.steady
        pulls = force_parts(self._forces)
        drawn = (
            *listed,
            *soft,
            *(x for x in levels if x is not None),
            *(x for x in pulls if isinstance(x, Tensor)),
        )
        numbers = common_shape((law.shape, *(tuple(v.shape) for v in drawn)))
        values = np.zeros((len(self._loads), MOST_VALUES, *numbers))
        for row, load in enumerate(self._loads):
            for column, value in enumerate(load.values):
                values[row, column] = value.numpy()
        steady = np.zeros((joints, *numbers))
        for j, level in enumerate(levels):
            if level is not None:
                steady[j] = level.numpy()
        groups, count = math.prod(numbers), windows * lanes
        shape = (windows, lanes)
        # Copies: the loop is compiled again for arrays that cannot be written, as views of one value are.
        group = np.array(np.broadcast_to(np.arange(groups).reshape(numbers), shape)).ravel()
        start = np.stack([x.expand(shape).numpy() for x in given.start]).reshape(2 * joints, count)
        # Where all lanes of a window have the same efforts, these are read from one of them.
        shared = lanes > 1 and all(x.stride(-1) == 0 for x in drives)
        sent = np.arange(windows).repeat(lanes) if shared else np.arange(count)
        width = 1 if shared else lanes
        begin, slope = (
            _stacked([x[..., :width] for x in each], (total, windows, width))
            for each in (given.begin, given.slope)
        )
        length = np.empty((0, windows * width))
        if given.length is not None:
            length = _stacked([given.length[..., :width]], (total, windows, width))[0]
        loads = np.empty((0, steps, count))
        if given.loads is not None:
            # One load may act in all lanes.
            spread = given.loads.expand(joints, steps, *shape)
            loads = np.ascontiguousarray(spread.numpy()).reshape(joints, steps, count)
        value = np.empty((2 * joints, steps + 1, count))
        left, right = np.empty((joints, steps, count)), np.empty((joints, steps, count))
        a = law.arrays
        tree = (a.parent, a.turns, a.rotation, a.offset, a.reference, a.limits, a.drives, a.gear)
        own = tuple(
            _in_groups(x, law.shape, numbers) for x in (law.inertia, law.gravity, law.passive, law.law)
        )
        time = np.array(np.broadcast_to(given.time.numpy(), shape)).ravel()
        ahead = np.zeros((joints, *numbers))
        for j, added in enumerate(given.friction.ahead or ()):
            ahead[j] = added.numpy()
        creeps = creep_table(given.friction.creeps, given.friction.joints, numbers).reshape(-1, 2, groups)
        tree_rollout(
            tree, group, own,
            np.array([KNOWN[load.kind] for load in self._loads], np.int64),
            np.array([(load.joint, load.source) for load in self._loads], np.int64).reshape(-1, 2),
            values.reshape(len(self._loads), MOST_VALUES, groups),
            np.array([force.joint for force in self._forces], np.int64), force_table(pulls, numbers),
            np.array(given.friction.joints, np.int64), creeps,
            steady.reshape(joints, groups), given.step, start, time, sent, begin, slope, length, loads,
            ahead.reshape(joints, groups), 1 if len(given.friction.joints) == 1 else SWEEPS, CLOSE,
            self._late, self._impulsive, value, left, right,
        )  # fmt: skip
        return RolloutResult(*(_parts(x, shape) for x in (value, left, right)))


def _as_known(load: EffectLoad) -> list[EffectLoad]:
    """Write a load as those that the loop knows.

    A constant load is a periodic one of frequency 0, detents of a slide have cycles on 2 pi m; a learned load is one
    load for each term that acts.
    """
    nothing = torch.zeros((), dtype=torch.float64)
    if load.kind == "constant_load":
        return [load._replace(kind="periodic", values=(nothing, *load.values, nothing))]
    if "pitch" in load.names:
        *waves, pitch = load.values
        return [load._replace(values=(*waves, 2.0 * math.pi / pitch))]
    if load.kind != LEARNED:
        return [load]
    own = dict(zip(load.names, load.values, strict=True))
    one = torch.ones((), dtype=torch.float64)
    scales = tuple(own.get(n, one) for n in ("speed_scale", "effort_scale", "angle_scale", "angle_middle"))
    return [
        load._replace(kind=f"{LEARNED}.{name}", values=(own[name], *scales))
        for name in TERMS
        if name in own and bool((own[name] != 0.0).any())
    ]


def _stacked(values: Sequence[Tensor], shape: tuple[int, int, int]) -> np.ndarray:
    """(M, n, N) of M signals (n, W, L)."""
    return np.stack([x.expand(shape).numpy() for x in values]).reshape(len(values), shape[0], -1)


def _in_groups(table: np.ndarray, had: tuple[int, ...], wanted: tuple[int, ...]) -> np.ndarray:
    """(..., G) numbers of the parameters, with one set for each group of a larger shape."""
    if had == wanted:
        return table
    rows = table.shape[:-1]
    whole = np.broadcast_to(table.reshape(*rows, *[1] * (len(wanted) - len(had)), *had), (*rows, *wanted))
    return np.array(whole).reshape(*rows, -1)


def _parts(table: np.ndarray, shape: tuple[int, int]) -> tuple[Tensor, ...]:
    return torch.from_numpy(table).view(*table.shape[:2], *shape).unbind(0)
