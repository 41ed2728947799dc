"""One cause that explains what a refit spread over many parameters.

The prior of a model file is a guess: it allows a drive's gain to be 20 % off, a centre of mass a tenth of the body and
a friction half. A refit under it explains a motor of 0.7 of its gain, a part in the gripper or a heavier link by these
parameters, and then nothing is left for a cause. Whether the file is rough in many of its values, or right but for one
thing, is a question of weights: the log evidence of one cause beside parameters as units of one make have them, of
those parameters alone, and of parameters that are as far off as their guesses allow. All three follow from the slopes
at the refit, which leaves only noise.

Source: Kass, Raftery, Bayes factors (1995), the Laplace approximation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.causes.tolerance import usual_sd
from deepkoco.diagnose.data_sheet import guessed, with_usual_spread
from deepkoco.diagnose.nothing_at_once import PLAUSIBLE, ROUGH
from deepkoco.diagnose.probability.shadow import linearised
from deepkoco.diagnose.refitted import Refitted
from deepkoco.fit.solve.scaled_inverse import DivergedError

# Log odds against a rough file and against no cause, from which one cause explains a log.
ODDS = math.log(10.0)
BEYOND = 3.0  # standard deviations of units of one make, from which a moved parameter asks for a cause


def is_asked(base: Refitted) -> bool:
    """Return whether somebody guessed priors, and the refit moved a parameter farther than units of one make differ.

    Healthy logs say what the unit is, so no more is asked beside them.

    Args:
        base: The refitted baseline.
    """
    start, values = base.start, base.reference.values
    if base.learned.healthy is not None or start.tempering > 1.0 or not guessed(start):
        return False
    known = (p for p in start.system.parameters if p.guessed and p.name in start.prior.names)
    return any(abs(values[p.name] - start.values[p.name]) > BEYOND * usual_sd(p) for p in known)


def one_cause(base: Refitted, causes: Sequence[Cause]) -> dict[str, float]:
    """Return how well each cause alone explains what a refit explains, where better than a rough file does.

    Args:
        base: The refitted baseline.
        causes: The catalogue.

    Returns:
        Names of the best cause and of those that are nearly as probable -> log odds [nats] against a rough file and
        against units of one make. Empty where the question is not asked, or no single cause is enough.
    """
    start, reference = base.start, base.reference
    if not is_asked(base):
        return {}
    usual = with_usual_spread(start)
    try:
        rough = linearised(base.problem, reference, start, causes, None, alone=True)
        point = linearised(base.problem, reference, usual, causes, None)
    except (DivergedError, np.linalg.LinAlgError):
        return {}
    told = [s for s in point.scored if not s.explanation.unknown]
    nothing = [s.log_weight for s in told if not s.explanation.causes]
    most = max(s.log_weight for s in rough.scored if not s.explanation.unknown)
    rivals = max(*nothing, most + ROUGH) + ODDS
    found: dict[str, float] = {}
    for scored in told:
        if len(scored.explanation.causes) == 1:
            (name,) = scored.explanation.causes
            found[name] = max(scored.log_weight - rivals, found.get(name, -math.inf))
    best = max(found.values(), default=0.0)
    return {name: odds for name, odds in found.items() if odds > best - PLAUSIBLE} if best > 0.0 else {}
