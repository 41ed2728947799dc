"""A common delay of all commands as the size of a whole robot, beside the sizes of its joints.

A goal goes through a bus, a driver and a firmware before any servo of an arm has it: a tenth of a second is usual, and
a model file knows nothing of it. No stiffness and no friction of a joint imitates this for all of them: a servo that is
soft enough to be late overshoots or sags. The joints' sizes are therefore searched for under some delays too. Where one
of them leaves less than half of what is left without, the refit frees it with the sizes. Like every parameter that a
refit moves far, it is a cause if the log shows that nothing else takes its place (:mod:`.evidence.far_parameters`).

Source: Bjelonic et al., Towards bridging the gap: systematic sim-to-real transfer for diverse legged robots (2025): one
delay of the robot beside armature, friction and zero of each joint.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from torch import Tensor

from deepkoco.diagnose.baseline import Baseline
from deepkoco.fit.shooting import ShootingProblem
from deepkoco.fit.solve.scale_search import cost_of, search_scales
from deepkoco.systems import ExtendedSystem
from deepkoco.systems.effects import effects_of
from deepkoco.systems.effects.effect import ALL

EFFECT = "actuation_delay"
LATE = 0.5  # share of the cost that sizes alone leave, below which the commands are taken to act late
DELAYS = (0.03, 0.08, 0.15, 0.25)  # [s]; from one to the next, slopes lead


def common_delay(system: ExtendedSystem) -> str | None:
    """Return the name of the delay of all commands of a system with every effect; None where it has none."""
    placed = [p for p in effects_of(system.base).values() if p.effect.name == EFFECT]
    whole = placed if len(placed) == 1 else [p for p in placed if p.index == ALL]
    return f"{whole[0].name}.delay" if whole else None


def with_delay_free(declared: Baseline, name: str) -> Baseline:
    """Return a baseline that frees a delay beside its own parameters, and whose simulation has it.

    Args:
        declared: The baseline with its prior as declared.
        name: The delay; 0 in the baseline.
    """
    prior = declared.prior.widened([declared.system.parameter(name)], declared.values)
    return replace(declared, prior=prior, effects=(*declared.effects, name.rpartition(".")[0]))


def sizes_when_late(
    problem: ShootingProblem,
    groups: Mapping[int, Mapping[str, str]],
    values: Mapping[str, float],
    state: Tensor,
    name: str,
) -> tuple[dict[str, float], float]:
    """Search sizes under each delay; return the best values, and the cost over that at the values given.

    Args:
        problem, groups, values, state: As for :func:`.search_scales`.
        name: The delay.
    """
    found = [search_scales(problem, groups, {**values, name: delay}, state)[0] for delay in DELAYS]
    best = min(found, key=lambda own: cost_of(problem, own, state))
    return best, cost_of(problem, best, state) / max(cost_of(problem, values, state), 1e-300)
