"""From log weights of explanations to probabilities of causes, their credible set and their sizes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deepkoco.diagnose.diagnosis import Estimate

CREDIBLE = 0.95
OTHER = 20.0  # nats behind a start that has not come to rest from which a stationary point is another minimum
LISTED = 12  # explanations in report.json


@dataclass(frozen=True)
class Weighed:
    """An explanation at its stationary point.

    Attributes:
        causes: Names of its causes; none for "nothing".
        log_weight: Log prior plus log evidence.
        stationary: Whether the refit ended at a stationary point.
        model_error: Standard deviations of the missing loads, in load scales: of the motion, in time.
        parameters: Changes of its causes by cause, with 95 % intervals, given this explanation.
    """

    causes: tuple[str, ...]
    log_weight: float
    stationary: bool
    model_error: tuple[float, float]
    parameters: dict[str, dict[str, Estimate]]


@dataclass(frozen=True)
class Answer:
    """Probabilities of all explanations that were refitted.

    Attributes:
        explanations: Best first, each set of causes once.
        probability: (E,) of each.
        tried: Number of sets that the search compared.
        seconds: Processor time.
    """

    explanations: tuple[Weighed, ...]
    probability: np.ndarray
    tried: int
    seconds: float

    @staticmethod
    def of(found: Sequence[Weighed], tried: int, seconds: float) -> Answer:
        """Normalise the weights; of equal sets of causes the best start counts, and stationary points count first.

        A stationary point that weighs far less than another start of its causes is a minimum of its own, not theirs.
        """
        best: dict[tuple[str, ...], Weighed] = {}
        for e in sorted(found, key=lambda e: -e.log_weight):
            top = best.setdefault(e.causes, e)
            if e.stationary and not top.stationary and e.log_weight > top.log_weight - OTHER:
                best[e.causes] = e
        ordered = sorted(best.values(), key=lambda e: -e.log_weight)
        log = np.array([e.log_weight for e in ordered])
        weight = np.exp(log - log.max())
        return Answer(tuple(ordered), weight / weight.sum(), tried, seconds)

    def of_cause(self, name: str) -> float:
        """Probability of a cause: the sum over all explanations that hold it."""
        return self.of_any([name])

    def of_any(self, names: Collection[str]) -> float:
        """Probability of one or more of these causes: the sum over all explanations that hold any of them."""
        held = (not {*names}.isdisjoint(e.causes) for e in self.explanations)
        return float(sum(p for yes, p in zip(held, self.probability, strict=True) if yes))

    @property
    def nothing(self) -> float:
        """Probability that nothing is wrong."""
        return float(sum(p for e, p in zip(self.explanations, self.probability, strict=True) if not e.causes))

    @property
    def causes(self) -> dict[str, float]:
        """Probability of each cause and of "unknown", the most probable first."""
        names = dict.fromkeys(name for e in self.explanations for name in e.causes)
        return dict(sorted(((n, self.of_cause(n)) for n in names), key=lambda pair: -pair[1]))

    @property
    def credible(self) -> tuple[tuple[str, ...], ...]:
        """Fewest explanations that together have 95 %."""
        count = int(np.searchsorted(np.cumsum(self.probability), CREDIBLE)) + 1
        return tuple(e.causes for e in self.explanations[:count])

    def to_json(self) -> dict[str, Any]:
        """Return the content of `evidence` in report.json."""
        rows = []
        for name, p in self.causes.items():
            holding = next(e for e in self.explanations if name in e.causes)
            sizes = {n: vars(v) for n, v in holding.parameters.get(name, {}).items()}
            rows.append({"name": name, "probability": p, "parameters": sizes})
        listed = zip(self.explanations[:LISTED], self.probability[:LISTED], strict=True)
        return {
            "nothing": self.nothing,
            "causes": rows,
            "credible_set": [list(names) for names in self.credible],
            "explanations": [
                {
                    "causes": list(e.causes),
                    "probability": float(p),
                    "log_weight": e.log_weight,
                    "stationary": e.stationary,
                    "model_error": list(e.model_error),
                }
                for e, p in listed
            ],
            "tried": self.tried,
            "cpu_s": self.seconds,
        }
