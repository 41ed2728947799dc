"""The equations of motion of a tree under one set of parameters, by the compiled loop where it can be used."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from torch import Tensor

from deepkoco.systems.engine_names import SEMI_IMPLICIT
from deepkoco.systems.motion import Acceleration, Motion
from deepkoco.systems.parameter import Parameters
from deepkoco.systems.plain import is_plain
from deepkoco.systems.trees.base_tilt import turned_gravity
from deepkoco.systems.trees.dynamics import Inertia, forward_dynamics
from deepkoco.systems.trees.engine import ahead
from deepkoco.systems.trees.fast import PASSIVE, FastLaw, TreeArrays
from deepkoco.systems.trees.geometry import shaped, turned_forces, turned_inertias
from deepkoco.systems.trees.loads import actuator_forces, clipped, passive_loads
from deepkoco.systems.trees.outside_forces import outside_forces, with_forces
from deepkoco.systems.trees.parameters import Law, actuator_law, joint_value, link_inertias
from deepkoco.systems.trees.scalars import Scalar, Triple, add, total
from deepkoco.systems.trees.stiffness import added_armatures
from deepkoco.systems.trees.tree import Engine, Joint, OutsideForce, Tree

LONGEST_STEP = 0.01  # of a fit [s]; see deepkoco.fit.data.windows


class Steadying(NamedTuple):
    """What decides the armatures that simulations add, see :func:`.added_armatures`."""

    least_inertias: tuple[float, ...]  # of each joint [kg m2 or kg]
    longest_step: float  # that the values of the file allow [s]
    engine: Engine | None = None  # of which the simulations are


class Numbers(NamedTuple):
    """What the equations of motion make of a set of parameters."""

    inertias: list[Inertia]
    gravity: Triple
    passive: dict[str, list[Scalar]]
    laws: list[Law]
    forces: tuple[OutsideForce, ...]
    joints: tuple[Joint, ...]
    as_given: bool  # whether the joints are those of the file

    @staticmethod
    def of(tree: Tree, parameters: Parameters, steadying: Steadying | None = None) -> Numbers:
        """Numbers of a tree under named values; ``steadying`` adds the armatures that simulations need.

        Steps of an engine that are taken as they are need none: what is too fast for them is so in the engine, too.
        """
        passive = {kind: [joint_value(parameters, kind, joint) for joint in tree.joints] for kind in PASSIVE}
        laws = [actuator_law(actuator, parameters) for actuator in tree.actuators]
        if steadying is not None and (steadying.engine is None or steadying.engine.name != SEMI_IMPLICIT):
            step = min(steadying.longest_step, LONGEST_STEP)
            added = added_armatures(tree.actuators, steadying.least_inertias, passive, laws, step)
            passive["armature"] = [add(a, b) for a, b in zip(passive["armature"], added, strict=True)]
            if steadying.engine is not None:
                early = ahead(steadying.engine, tree.actuators, steadying.least_inertias, passive, laws)
                passive["armature"] = [add(a, b) for a, b in zip(passive["armature"], early, strict=True)]
        inertias, forces = link_inertias(tree, parameters), outside_forces(tree, parameters)
        gravity, shape = turned_gravity(tree.gravity, parameters), shaped(tree, parameters)
        if shape is None:
            return Numbers(inertias, gravity, passive, laws, forces, tree.joints, True)
        inertias, forces = turned_inertias(shape, inertias), turned_forces(shape, forces)
        return Numbers(inertias, gravity, passive, laws, forces, shape.joints, False)

    def without_forces(self) -> Numbers:
        """The same, for callers that add the loads of the forces themselves."""
        return self._replace(forces=())

    def without_dry_friction(self) -> Numbers:
        """The same, for simulations, which treat dry friction on its own."""
        return self._replace(passive={**self.passive, "frictionloss": [0.0] * len(self.joints)})

    def fast(self, arrays: TreeArrays) -> FastLaw | None:
        """The compiled loop; None where it cannot be used: it knows the joints of the file, and no outside forces."""
        if not self.as_given or self.forces:
            return None
        flat = [v for inertia in self.inertias for v in (inertia.mass, *inertia.first, *inertia.second)]
        flat += [*self.gravity, *(v for values in self.passive.values() for v in values)]
        flat += [v for law in self.laws for v in (*law.gain, *law.bias, law.low, law.high)]
        if not is_plain(flat):
            return None
        return FastLaw(arrays, self.inertias, self.gravity, list(self.passive.values()), self.laws)


def equations_of_motion(
    tree: Tree, numbers: Numbers, arrays: TreeArrays, smooth: Sequence[float]
) -> Acceleration:
    """motion -> accelerations of the joints [rad/s2, m/s2].

    Args:
        tree: The description.
        numbers: Of its parameters.
        arrays: Of the description, for the compiled loop.
        smooth: Speed of each joint over which the sign of dry friction changes [rad/s, m/s].
    """
    passive = numbers.passive
    fast = numbers.without_forces().fast(arrays)
    given_arrays = arrays if numbers.as_given else None
    dynamics = forward_dynamics(numbers.joints, numbers.inertias, passive["armature"], numbers.gravity)
    forces = actuator_forces(tree.actuators, numbers.laws)
    resisting = passive_loads(passive, smooth)
    drives = actuators_of_joints(tree)

    def acceleration(motion: Motion) -> tuple[Tensor, ...]:
        motion = with_forces(motion, numbers.joints, numbers.forces, given_arrays)
        if fast is not None and is_plain(_all_of(motion)):
            return fast(motion, smooth)
        given = forces(motion)
        loads: list[Scalar] = []
        for j, joint in enumerate(tree.joints):
            load = clipped(total([given[k] for k in drives[j]]), joint.force_low, joint.force_high)
            load = add(load, resisting(motion, j))
            if motion.loads is not None and (outside := motion.loads[j]) is not None:
                load = add(load, outside)
            loads.append(load)
        return dynamics(motion.angles, motion.speeds, loads)

    return acceleration


def actuators_of_joints(tree: Tree) -> list[list[int]]:
    """Indices of the actuators of each joint."""
    found: list[list[int]] = [[] for _ in tree.joints]
    for k, actuator in enumerate(tree.actuators):
        found[actuator.joint].append(k)
    return found


def _all_of(motion: Motion) -> list[Tensor | None]:
    parts = [*motion.angles, *motion.speeds, *motion.efforts]
    return [*parts, *(motion.loads or ()), *(motion.smoothing or ())]
