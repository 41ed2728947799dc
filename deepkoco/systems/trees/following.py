"""Robots with joints that follow others: linkages whose coupler keeps its direction, as URDF states them (`mimic`)."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.drawn import Outline
from deepkoco.systems.dry_friction import Levels
from deepkoco.systems.motion import (
    Acceleration,
    CommandTiming,
    Delivery,
    InverseInertia,
    Motion,
    PayloadWay,
    Timing,
)
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System
from deepkoco.systems.trees.compile_tree import compile_tree
from deepkoco.systems.trees.held_joints import Follower
from deepkoco.systems.trees.model_file import read_followers, read_model
from deepkoco.systems.trees.settings import TreeSettings
from deepkoco.systems.trees.tree import Tree, TreeError
from deepkoco.systems.trees.tree_system import TreeSystem

HEAVY = (
    0.1  # share of all moving mass from which a joint that follows another moves with it; fingers are lighter
)
OWN = (
    "armature",
    "damping",
    "frictionloss",
)  # parameters of a joint that belong to its leader, where they are 0


class FollowingSystem(System):
    r"""The tree M a = f, of which each follower keeps a_f = r a_l, with its own joint left out of the state.

    C a = 0 has a row e_f - r e_l for each follower. The loads C^T \lambda that keep it change the accelerations a of
    the free tree by W C^T \lambda with the inverse inertia W, so \lambda = -(C W C^T)^-1 C a.

    Args:
        base: The tree with all joints free.
        followers: Joints that follow others, none of which follows a third one.
    """

    def __init__(self, base: TreeSystem, followers: Sequence[Follower]) -> None:
        self.base = base
        self.name, self.origin = base.name, base.origin
        self.payload_sites, self.tip, self.force_sites = base.payload_sites, base.tip, base.force_sites
        number = {name: j for j, name in enumerate(base.joint_names)}
        reference = {joint.name: joint.reference for joint in base.tree.joints}
        self.followers = tuple(followers)
        # Both coordinates count from the position in which the model is drawn.
        self._follows = {
            number[f.name]: (
                number[f.leader],
                f.ratio,
                reference[f.name] + f.offset - f.ratio * reference[f.leader],
            )
            for f in followers
        }
        self.free = tuple(j for j in range(base.joints) if j not in self._follows)
        self.joints = len(self.free)
        states = (*self.free, *(base.joints + j for j in self.free))
        self.state_names = tuple(base.state_names[k] for k in states)
        self.state_units = tuple(base.state_units[k] for k in states)
        self.measurements = tuple(base.measurements[k] for k in states)
        own = {f"{kind}({f.name})" for kind in OWN for f in followers}
        self.parameters = tuple(p for p in base.parameters if p.name not in own or p.value != 0.0)
        self.notes = (
            *base.notes,
            *(f'the joint "{f.name}" follows "{f.leader}" and moves with it' for f in followers),
        )

    commands = property(lambda self: self.base.commands)

    def way_to_hold(self, channels: Collection[str]) -> str:
        return self.base.way_to_hold(channels)

    drives = property(lambda self: self.base.drives)
    delivered_scales = property(lambda self: self.base.delivered_scales)
    drive_parameters = property(lambda self: self.base.drive_parameters)
    tilt_parameters = property(lambda self: self.base.tilt_parameters)
    longest_step = property(lambda self: self.base.longest_step)
    joint_names = property(lambda self: tuple(self.base.joint_names[j] for j in self.free))
    actuator_joints = property(lambda self: tuple(self.free.index(j) for j in self.base.actuator_joints))
    load_scales = property(lambda self: tuple(self.base.load_scales[j] for j in self.free))
    load_scale = property(lambda self: max(self.load_scales))

    @property
    def command_joints(self) -> tuple[int, ...]:
        return tuple(self.free.index(j) for j in self.base.command_joints)

    def effort_of(self, commands: Tensor) -> Tensor:
        return self.base.effort_of(commands)

    def shape_command(self, index: int, value: Tensor, t: Tensor, parameters: Parameters) -> Tensor:
        return self.base.shape_command(index, value, t, parameters)

    def actuate(self, command: Tensor, parameters: Parameters) -> Tensor:
        return self.base.actuate(command, parameters)

    def command_timing(self, index: int, parameters: Parameters) -> CommandTiming:
        return self.base.command_timing(index, parameters)

    def timing(self, parameters: Parameters) -> Timing:
        return self.base.timing(parameters)

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return self.base.with_payload(mass, parameters)

    def with_payload_at(
        self, site: str, mass: Tensor, parameters: Parameters, along: Tensor | None = None
    ) -> Parameters:
        return self.base.with_payload_at(site, mass, parameters, along)

    def payload_way(self, site: str) -> PayloadWay | None:
        return self.base.payload_way(site)

    def force_parameters(self, site: str) -> tuple[Parameter, ...]:
        return self.base.force_parameters(site)

    def with_force_at(self, site: str, force: Parameters, parameters: Parameters) -> Parameters:
        return self.base.with_force_at(site, force, parameters)

    def accelerations(self, parameters: Parameters) -> Acceleration:
        law = self.base.accelerations(parameters)
        return self._following(law, _answers(law, self.base.joints))

    def free_accelerations(self, parameters: Parameters) -> Acceleration:
        return self._following(
            self.base.free_accelerations(parameters), self.base.inverse_inertia(parameters)
        )

    def dry_friction_limits(self, parameters: Parameters) -> Levels:
        limits = list(self.base.dry_friction_limits(parameters))
        for f, (leader, ratio, _) in self._follows.items():
            own, more = limits[leader], limits[f]
            if more is not None:
                limits[leader] = abs(ratio) * more if own is None else own + abs(ratio) * more
        return tuple(limits[j] for j in self.free)

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        # Simulations slow down what is too fast for any log, as those of the tree do.
        parts, joints = state.unbind(-1), self.joints
        efforts = (effort,) if len(self.commands) == 1 else effort.unbind(-1)
        speeds = parts[joints:]
        smoothing = tuple(torch.full_like(speeds[0], speed) for speed in self.smoothing_speeds)
        friction = self.dry_friction_limits(parameters)
        loads = tuple(
            None if limit is None else -limit * torch.tanh(speed / over)
            for limit, speed, over in zip(friction, speeds, smoothing, strict=True)
        )
        found = self.free_accelerations(parameters)(Motion(parts[:joints], speeds, efforts, loads))
        return torch.stack(torch.broadcast_tensors(*speeds, *found), -1)

    def delivery(self, parameters: Parameters) -> Delivery | None:
        deliver = self.base.delivery(parameters)
        return None if deliver is None else lambda motion: deliver(self._whole(motion))

    def with_length(self, factor: Tensor, joint: int, parameters: Parameters) -> Parameters:
        return self.base.with_length(factor, self.free[joint], parameters)

    def outline(self, angles: np.ndarray) -> Outline | None:
        return self.base.outline(self._all(np.asarray(angles, dtype=float)))

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        shown = np.asarray(measurement, dtype=float)[: self.joints]
        self.base.draw_on(image, self._all(shown), command)

    def _all(self, angles: np.ndarray) -> np.ndarray:
        """Coordinates of all joints of the tree from those of the free ones (J, ...)."""
        whole = np.zeros((self.base.joints, *angles.shape[1:]))
        whole[list(self.free)] = angles
        for f, (leader, ratio, offset) in self._follows.items():
            whole[f] = ratio * whole[leader] + offset
        return whole

    def _whole(self, motion: Motion) -> Motion:
        """The motion of all joints of the tree."""
        at = {j: k for k, j in enumerate(self.free)}

        def of(values: Sequence[Tensor], places: bool) -> tuple[Tensor, ...]:
            found = []
            for j in range(self.base.joints):
                leader, ratio, offset = self._follows.get(j, (j, 1.0, 0.0))
                value = values[at[leader]]
                if j in self._follows:
                    value = ratio * value + (offset if places else 0.0)
                found.append(value)
            return tuple(found)

        loads, smoothing = motion.loads, motion.smoothing
        return motion._replace(
            angles=of(motion.angles, True),
            speeds=of(motion.speeds, False),
            loads=None
            if loads is None
            else tuple(loads[at[j]] if j in at else None for j in range(self.base.joints)),
            smoothing=None
            if smoothing is None
            else tuple(smoothing[at[self._follows.get(j, (j,))[0]]] for j in range(self.base.joints)),
        )

    def _following(self, law: Acceleration, inverse: InverseInertia) -> Acceleration:
        follows, free = self._follows, self.free

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            whole = self._whole(motion)
            found, rows = law(whole), inverse(whole)
            # W C^T, and from it C W C^T and C a.
            answers = {
                f: [row[f] - ratio * row[leader] for row in rows] for f, (leader, ratio, _) in follows.items()
            }
            apart = [found[f] - ratio * found[leader] for f, (leader, ratio, _) in follows.items()]
            matrix = [
                [answers[g][f] - ratio * answers[g][leader] for g in follows]
                for f, (leader, ratio, _) in follows.items()
            ]
            loads = _solved(matrix, [-a for a in apart])
            result = []
            for j in free:
                change = found[j]
                for g, load in zip(follows, loads, strict=True):
                    change = change + answers[g][j] * load
                result.append(change)
            return tuple(result)

        return acceleration


def robot_from_file(path: str | Path) -> System:
    """Read a robot from an MJCF or URDF file; joints that follow others and carry mass move with their leaders.

    Light ones, as fingers are, are held; see :func:`.hold_joints`.

    Args:
        path: The file; see :meth:`.TreeSystem.from_file`.

    Raises:
        TreeError: The file cannot be read, or is no contact-free tree of hinges and slides.
    """
    path = Path(path)
    settings = TreeSettings.beside(path)
    following = read_followers(path, settings.held)
    if not following:
        return TreeSystem.from_file(path)
    try:
        model, _ = read_model(path, settings.held, [f.name for f in following])
        heavy = _heavy(compile_tree(model, path.stem), following)
        if not heavy:
            return TreeSystem.from_file(path)
        model, notes = read_model(path, settings.held, [f.name for f in heavy])
        tree = compile_tree(model, path.stem)
    except TreeError:
        return TreeSystem.from_file(path)
    driven = {f.name for f in heavy}
    actuators = tuple(a for a in tree.actuators if tree.joints[a.joint].name not in driven)
    tree = replace(tree, actuators=actuators, notes=(*notes, *tree.notes))
    return FollowingSystem(TreeSystem(tree, str(path), settings), heavy)


def _heavy(tree: Tree, following: Sequence[Follower]) -> list[Follower]:
    """Followers that carry more than a share of all moving mass."""
    number = {joint.name: j for j, joint in enumerate(tree.joints)}
    behind = {j: {j} for j in range(len(tree.joints))}
    for j in reversed(range(len(tree.joints))):
        parent = tree.joints[j].parent
        if parent >= 0:
            behind[parent] |= behind[j]
    total = sum(body.mass for body in tree.bodies)
    carried = {
        f.name: sum(b.mass for b in tree.bodies if b.joint in behind[number[f.name]]) for f in following
    }
    return [f for f in following if carried[f.name] > HEAVY * total]


def _answers(law: Acceleration, joints: int) -> InverseInertia:
    """Answer of accelerations to unit loads; that of the tree has the armatures of simulations."""

    def inverse(motion: Motion) -> tuple[tuple[Tensor, ...], ...]:
        bare, one = motion._replace(loads=None), torch.ones_like(motion.speeds[0])
        at_rest = law(bare)
        columns = [
            law(bare._replace(loads=tuple(one if k == j else None for k in range(joints))))
            for j in range(joints)
        ]
        return tuple(tuple(columns[k][j] - at_rest[j] for k in range(joints)) for j in range(joints))

    return inverse


def _solved(matrix: list[list[Tensor]], right: list[Tensor]) -> list[Tensor]:
    """Solution of a small positive definite system, entry by entry."""
    rows, values, count = [list(row) for row in matrix], list(right), len(right)
    for k in range(count):
        for i in range(k + 1, count):
            share = rows[i][k] / rows[k][k]
            rows[i] = [rows[i][j] - share * rows[k][j] for j in range(count)]
            values[i] = values[i] - share * values[k]
    found: list[Tensor] = [values[0]] * count
    for k in reversed(range(count)):
        left = values[k]
        for j in range(k + 1, count):
            left = left - rows[k][j] * found[j]
        found[k] = left / rows[k][k]
    return found
