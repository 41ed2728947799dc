"""Whether the selected causes are improbable beside all other explanations: evidence as a witness against a name.

A selection takes the best cause of the catalogue. Where the true cause is in no catalogue, the best is not good: a
spring that acts to one side is a wrong scale of the encoder before it is nothing. The explanations of
:mod:`deepkoco.diagnose.probability` hold the rivals that the selection lacks: any load that is a smooth function of the
motion, alone or beside a cause. A right cause whose exact shape the catalogue lacks is more probable beside such a load
than the load alone; a wrong one adds nothing to it.
"""

from __future__ import annotations

from deepkoco.diagnose.explanation import Explanation

MOST_DOUBTED = 0.5  # probability up to which a cause is no name: the log is explained without it as well


def outweighed(explanation: Explanation) -> str | None:
    """Return why no cause is named, if the log is more probably explained without any of the selected causes.

    Only a selection that leaves more than noise is asked. One that explains the log has proved itself, and how probable
    its members are among each other is said by its class.

    Args:
        explanation: The selected causes, with the weights of explanations.

    Returns:
        One sentence; None where the causes stand, or where nothing was weighed that could tell.
    """
    base, found, weights = explanation.base, explanation.found, explanation.weights
    if weights is None or found.lost is not None or not found.accepted:
        return None
    # A cause that has stood on longer windows is not doubted for what shorter ones told of it.
    if explanation.longer:
        return None
    left = found.final.chi2 / base.train.samples
    if left <= base.start.most_noise(base.train):
        return None
    classes = [{*members} for _, members in found.steps]
    # What was not weighed cannot be told from a right cause.
    if any(all(names.isdisjoint(e.causes) for e in weights.explanations) for names in classes):
        return None
    chance = max(weights.of_any(names) for names in classes)
    if chance > MOST_DOUBTED:
        return None
    names, best = " and ".join(c.name for c in found.accepted), weights.explanations[0].causes
    rival = "a smooth load that is in no catalogue" if "unknown" in best else "other explanations"
    return (
        f"With {names}, a mean squared error of {left:.3g} noise variances remains; the probability of such a cause is "
        f"{chance:.2g}, because {rival} and what any unit has explain the log better without it."
    )
