"""Whether selected causes explain anything beside a learned load: the witness against names that imitate a shape.

Three causes together may imitate a spring that acts to one side. They leave a little more than noise, and a learned
load (:mod:`deepkoco.diagnose.evidence.residual_model`) leaves none. That alone does not contradict them: a right cause
leaves a model error, which such a load takes up together with what the cause does. So the causes get a learned load of
their own for what they leave. Right causes with it are ahead of a load without them; wrong ones shrink to nothing
beside it and only pay for their parameters.
"""

from __future__ import annotations

import math
from dataclasses import replace

from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import penalty
from deepkoco.diagnose.evidence.residual_model import ResidualModel, learn_residual
from deepkoco.diagnose.evidence.selected import Selected, learned_instead
from deepkoco.diagnose.evidence.selection import FURTHER
from deepkoco.diagnose.refitted import Refitted
from deepkoco.diagnose.residuals.residuals import SLOTS, dispersion, missing_torque
from deepkoco.fit.solve.scaled_inverse import DivergedError

KEPT = 0.5  # share of a size that a right cause keeps beside a load for what it leaves


def idle_beside(base: Refitted, found: Selected, learned: ResidualModel, seed: int) -> str | None:
    """Return why no cause is named, if a learned load explains a log to its noise and causes add nothing to it.

    Args:
        base: The refitted baseline.
        found: The causes; they leave more than noise.
        learned: Load learned on top of the refit.
        seed: Of the bootstrap.

    Returns:
        One sentence; None where the causes stand, or where their simulation beside a load diverges.
    """
    start, train = base.start, base.train
    if not learned.accepted or learned.after > start.most_noise(train):
        return None
    if not learned_instead(found, base.reference, learned, start, train, FURTHER):
        return None
    try:
        own = _load_beside(base, found, seed)
    except DivergedError:
        return None
    if own is None or _ahead(base, found, own, learned) > 0.0 or _keep_a_size(base, found, own):
        return None
    names, left = " and ".join(c.name for c in found.accepted), found.final.chi2 / train.samples
    return (
        f"With {names}, a mean squared error of {left:.3g} noise variances remains. A learned load leaves "
        f"{learned.after:.3g}, and beside such a load {names} explains nothing more."
    )


def _load_beside(base: Refitted, found: Selected, seed: int) -> ResidualModel | None:
    """Learn a load for what the causes leave; their sizes stay free beside it."""
    prior = prior_with(base.problem, base.start, found.accepted, found.final.values)
    left = missing_torque(base.problem, found.final, dispersion(found.final, base.train).deflation)
    start = replace(base.start, prior=prior)
    return learn_residual(start, base.train, base.held, found.final, left, seed)


def _ahead(base: Refitted, found: Selected, own: ResidualModel, learned: ResidualModel) -> float:
    """Return by how much the BIC of the causes with their load is lower than that of the load without them."""
    spread = dispersion(min(own.fit, learned.fit, key=lambda fit: fit.cost), base.train)
    samples = base.train.samples / spread.correlation
    charge = (len(own.terms) - len(learned.terms)) * math.log(samples)
    charge += sum(penalty(cause, samples, SLOTS * len(base.train)) for cause in found.accepted)
    return (learned.fit.cost - own.fit.cost) / max(spread.deflation, base.start.least_deflation) - charge


def _keep_a_size(base: Refitted, found: Selected, own: ResidualModel) -> bool:
    """Return whether a size of the causes stays as large beside their load as a share of what it was without one.

    A bias is also a term of a load. Then both explanations are one, and neither is ahead; but the bias keeps its size.
    """
    null = base.start.values
    sizes = [n for cause in found.accepted for n in cause.sizes]
    return any(abs(own.fit.values[n] - null[n]) >= KEPT * abs(found.final.values[n] - null[n]) for n in sizes)
