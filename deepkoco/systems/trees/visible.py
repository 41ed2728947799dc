"""Parameters that no motion can show, such as the mass of a first link that turns about a vertical axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from deepkoco.systems.motion import Motion
from deepkoco.systems.parameter import Parameter
from deepkoco.systems.system import System
from deepkoco.systems.trees.parameters import AXES
from deepkoco.systems.trees.tree import Tree

MOTIONS = 16
# An acceleration at one instant shows no time on the way of a command, and one far from the limits of the forces shows
# no limit; a joint always follows a force.
SHOWN_OTHERWISE = ("time_constant(", "delay(", "force_limit(")
STEP = 1e-3  # of a parameter [prior standard deviations]
FAINT = (
    1e-7  # change of an acceleration per prior standard deviation that is rounding, per largest acceleration
)


def visible_parameters(
    system: System, tree: Tree, declared: Sequence[Parameter], seed: int = 0
) -> tuple[Parameter, ...]:
    """Those of the declared parameters that change an acceleration in random motions, those in time, and limits.

    Args:
        system: Equations of motion of the tree.
        tree: Its joints and actuators.
        declared: Parameters of the system.
        seed: Of the motions.
    """
    draw = np.random.default_rng(seed)
    shape = (MOTIONS, 1)

    def drawn(size: float) -> torch.Tensor:
        return torch.from_numpy(draw.uniform(-size, size, shape))

    angles = tuple(j.reference + drawn(0.3 if j.slides else 3.0) for j in tree.joints)
    speeds = tuple(drawn(0.5 if j.slides else 3.0) for j in tree.joints)
    sizes = [max(abs(c.low), abs(c.high)) for c in system.commands]
    # Far from the limits of the forces, behind which gains have no say.
    efforts = []
    for actuator, size in zip(tree.actuators, sizes, strict=True):
        servo = actuator.bias[1] * actuator.gain[0] < 0.0
        near = -actuator.bias[1] / actuator.gain[0] * actuator.gear * angles[actuator.joint] if servo else 0.0
        efforts.append(near + drawn(1e-3 * size))
    # A flat body cannot become flatter: what another moment would then become is nothing that a motion shows of it.
    thicker = {f"inertia_{a}({b.name})": max(b.moments) for b in tree.bodies for a in AXES}
    start = {p.name: p.value + thicker.get(p.name, 0.0) for p in declared}
    values = {n: torch.full((len(declared) + 1,), v, dtype=torch.float64) for n, v in start.items()}
    for k, p in enumerate(declared):
        step = STEP * p.prior_sd
        values[p.name][k + 1] += step if p.value + step <= p.high else -step
    found = torch.stack(system.accelerations(values)(Motion(angles, speeds, tuple(efforts))))  # (J, n, P + 1)
    change = (found[..., 1:] - found[..., :1]).abs().amax((0, 1)) / STEP
    scale = float(found.abs().max())
    return tuple(
        p
        for p, c in zip(declared, change.tolist(), strict=True)
        if c > FAINT * scale or p.name.startswith(SHOWN_OTHERWISE)
    )
