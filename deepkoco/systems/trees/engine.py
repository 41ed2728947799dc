"""How engines simulate a tree: how softly dry friction holds its joints, and when commands act within their steps.

Semi-implicit steps v' = v + h a(q, v, u), q' = q + h v' are q(t + h) - 2 q(t) + q(t - h) = h^2 a: a command that is
held from t to t + h acts on the motion from t - h / 2 to t + h / 2. Half a step at 2 rad/s is 2 mrad with the default
step of 2 ms, which a good encoder shows. The speed in a is that of t - h / 2, and that of t + h / 2 for a damping that
is integrated implicitly. A damping D that is ahead of the other loads by h is -D (v + h q''): an armature of D h. Steps
of Runge-Kutta have none of this. What is left is of the order of h^2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from deepkoco.systems.creep import Creep
from deepkoco.systems.dry_friction import DryFriction
from deepkoco.systems.motion import Acceleration, Motion
from deepkoco.systems.trees.dynamics import Inertia, inverse_mass
from deepkoco.systems.trees.mujoco_library import Model, mujoco_library
from deepkoco.systems.trees.parameters import Law
from deepkoco.systems.trees.scalars import Scalar, add, mul
from deepkoco.systems.trees.stiffness import larger
from deepkoco.systems.trees.tree import Actuator, Engine, Joint, Softness

LARGEST_SHARE = 0.5  # of the inertia that a joint moves, which a damping below 0 may take off
LEAST_IMPEDANCE, MOST_IMPEDANCE = 1e-4, 0.9999  # mjMINIMP, mjMAXIMP
ONLY_SLIDES = 2  # `body_simple` of a body with diagonal inertia whose joints are all slides


def engine_of(model: Model) -> Engine | None:
    """How MuJoCo simulates a model of hinges and slides; None where it has no step or a friction without a rate.

    Args:
        model: Compiled model.
    """
    soft = [friction_softness(model, int(model.jnt_dofadr[j])) for j in range(model.njnt)]
    step = float(model.opt.timestep)
    if not step > 0.0 or any(own is None for own in soft):
        return None
    library = mujoco_library()
    # Steps that prevent slip make friction hold.
    own = None if model.opt.noslip_iterations > 0 else tuple(each for each in soft if each is not None)
    if model.opt.integrator == library.mjtIntegrator.mjINT_RK4:
        return Engine(own, step)
    euler = model.opt.integrator == library.mjtIntegrator.mjINT_EULER
    explicit = euler and bool(model.opt.disableflags & library.mjtDisableBit.mjDSBL_EULERDAMP)
    if model.opt.integrator == library.mjtIntegrator.mjINT_IMPLICIT:
        return Engine(own, step, 0.5, -0.5, 0.5)  # all smooth loads are implicit
    return Engine(own, step, 0.5, 0.5, 0.5, 0.0 if explicit else 1.0, 0.0 if euler else 1.0)


def softness_in(engine: Engine) -> tuple[Softness, ...] | None:
    """How softly dry friction holds each joint in steps of the engine's length; None where it holds.

    The constraint is D (v' + b (v - late v')), which semi-implicit steps find from the speed of half a step before.
    """
    if engine.softness is None:
        return None
    return tuple(_with_late_speed(_slowed(own, engine.step), engine.lead) for own in engine.softness)


def _slowed(soft: Softness, step: float) -> Softness:
    return (
        soft
        if soft.slowest * step == 0.0
        else soft._replace(rate=min(soft.rate, 1.0 / (soft.slowest * step)))
    )


def _with_late_speed(soft: Softness, late: float) -> Softness:
    kept = 1.0 - soft.rate * late
    return soft if kept <= 0.0 else soft._replace(inertia=soft.inertia * kept, rate=soft.rate / kept)


def ahead(
    engine: Engine,
    actuators: Sequence[Actuator],
    least: Sequence[float],
    passive: Mapping[str, Sequence[Scalar]],
    laws: Sequence[Law],
) -> list[Scalar]:
    """Armature of each joint [kg m2 or kg] that stands for a damping which is ahead of the other loads.

    Args:
        engine: How the tree is simulated.
        actuators: Of the tree.
        least: Smallest inertia that each joint moves; no more than half of it is taken off, by a damping below 0.
        passive: Damping of each joint.
        laws: Gain and bias of each actuator.
    """
    added = [mul(engine.joints_ahead * engine.step, damping) for damping in passive["damping"]]
    for actuator, law in zip(actuators, laws, strict=True):
        j = actuator.joint
        added[j] = add(added[j], mul(-engine.drives_ahead * engine.step * actuator.gear**2, law.bias[2]))
    return [larger(own, -LARGEST_SHARE * most) for own, most in zip(added, least, strict=True)]


def creeping(
    friction: DryFriction,
    softness: Sequence[Softness],
    joints: Sequence[Joint],
    inertias: Sequence[Inertia],
    armatures: Sequence[Scalar],
    added: Sequence[Scalar],
) -> DryFriction:
    """Dry friction that creeps with the inertia that each joint moves at its reference.

    Args:
        friction: Levels.
        softness: Of each joint.
        joints, inertias, armatures: Of the tree, as for :func:`.inverse_mass`.
        added: As of :func:`ahead`.
    """
    at = [torch.tensor(joint.reference, dtype=torch.float64) for joint in joints]
    # No other joint moves a bare one, so its row of the inverse is that of its body.
    seen = [0.0 if soft.bare else armature for soft, armature in zip(softness, armatures, strict=True)]
    inverse = inverse_mass(joints, inertias, seen, at)
    creeps = tuple(Creep(soft.inertia / inverse[j][j], soft.rate) for j, soft in enumerate(softness))
    if all(not isinstance(x, Tensor) and x == 0.0 for x in added):
        return replace(friction, creeps=creeps)
    early = tuple(torch.as_tensor(x, dtype=torch.float64) for x in added)
    return replace(friction, creeps=creeps, ahead=early)


def with_late_speeds(law: Acceleration, late: float) -> Acceleration:
    """Accelerations of which every load has the speed of a time ``late`` [s] before: a(v - late a(v))."""

    def acceleration(motion: Motion) -> tuple[Tensor, ...]:
        first = law(motion)
        speeds = tuple(v - late * a for v, a in zip(motion.speeds, first, strict=True))
        return law(motion._replace(speeds=speeds))

    return acceleration


def friction_softness(model: Model, dof: int) -> Softness | None:
    """The soft constraint of a degree of freedom, from ``solreffriction`` and ``solimpfriction``.

    The violation of a friction constraint is always 0, so its impedance is the first of the five numbers, and its
    reference acceleration is -b v.

    Args:
        model: Compiled model.
        dof: Index of the degree of freedom.

    Returns:
        The constraint; None where it has no rate.

    Source: MuJoCo documentation, Modeling, "Solver parameters": solimp, solref, and diagApprox of the regulariser R.
    """
    time_constant, damping = (float(x) for x in model.dof_solref[dof])
    least, most = (min(max(float(x), LEAST_IMPEDANCE), MOST_IMPEDANCE) for x in model.dof_solimp[dof, :2])
    impedance = least if least != most and float(model.dof_solimp[dof, 2]) > 0.0 else 0.5 * (least + most)
    slowest = 0.0
    if time_constant > 0.0:
        safe = not model.opt.disableflags & mujoco_library().mjtDisableBit.mjDSBL_REFSAFE
        rate, slowest = 2.0 / (most * time_constant), most if safe else 0.0
    else:
        rate = -damping / most
    if not rate > 0.0:
        return None
    # MuJoCo sets `dof_invweight0` of a body that hangs on slides alone, and carries none that moves, to 1 / mass.
    bare = int(model.body_simple[model.dof_bodyid[dof]]) == ONLY_SLIDES
    return Softness(impedance / (1.0 - impedance), rate, slowest, bare)
