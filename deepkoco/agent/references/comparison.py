"""Costs of a trained controller against those of references, as paired differences with their intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import rankdata, wilcoxon

from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.koopman.exported import Array
from deepkoco.pages.units import rounded

ZERO, RANDOM, EDMDC = "zero action", "random episodes", "EDMDc + planner"
LARGEST_COST = 1e100
"""What a cost that is infinite or no number counts as; the square of its spread must be a number."""


LARGEST_P = 0.05


@dataclass(frozen=True)
class MeanCost:
    """Mean cost of episodes with its 95 % interval.

    Attributes:
        mean: [cost].
        low, high: Limits by Student's t; NaN for a single episode.
    """

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, costs: Array) -> MeanCost:
        """From the costs of episodes (n,)."""
        return cls(*mean_with_band(costs))


@dataclass(frozen=True)
class Reference:
    """Another controller on the same start states.

    Attributes:
        name: Which one.
        cost: What it costs.
        difference: Cost of the trained controller minus its cost, paired by start state; below 0 is better.
        verdict: How the trained controller does beside it: "better", "worse" or "no difference" at 95 %.
    """

    name: str
    cost: MeanCost
    difference: MeanCost
    verdict: str

    @classmethod
    def of(cls, name: str, own: Array, costs: Array) -> Reference:
        """From costs of the same start states (n,) of the trained controller and of the reference.

        The interval of the mean difference decides. Where one of them diverged from some start states, whose costs
        hide all others in a mean, the signed ranks of the differences do (Wilcoxon, Individual comparisons by ranking
        methods, 1945), but who diverges more often is not called better.
        """
        difference = MeanCost.of(own - costs)
        often = [int((np.abs(c) >= LARGEST_COST).sum()) for c in (own, costs)]
        verdict = "better" if difference.high < 0 else "worse" if difference.low > 0 else "no difference"
        if verdict == "no difference" and any(often):
            verdict = _verdict_of_ranks(own - costs, often[0] - often[1])
        return cls(name, MeanCost.of(costs), difference, verdict)


@dataclass(frozen=True)
class Comparison:
    """A trained controller and its references.

    Attributes:
        agent: Name of the trained one.
        costs: Of each start state (n,), by controller; the trained one first.
        left_out: References that could not be measured, with the reason.
        advice: What to try where the controller is not better than all; what matters most first.
        kept: What the controller is, where it is not what was trained; empty otherwise.
    """

    agent: str
    costs: Mapping[str, Array]
    left_out: Mapping[str, str] = field(default_factory=dict)
    advice: tuple[str, ...] = ()
    kept: str = ""

    @property
    def own(self) -> MeanCost:
        """Cost of the trained controller."""
        return MeanCost.of(self._finite(self.agent))

    @property
    def references(self) -> list[Reference]:
        """The others, as far as they were measured."""
        own, names = self._finite(self.agent), [name for name in self.costs if name != self.agent]
        costs = {name: self._finite(name) for name in names}
        return [Reference.of(name, own, c) for name, c in costs.items()]

    def named(self, verdict: str) -> list[str]:
        """Names of the references beside which the trained controller has this verdict."""
        return [reference.name for reference in self.references if reference.verdict == verdict]

    @property
    def needs_advice(self) -> bool:
        """Whether the controller is not clearly better than every reference."""
        return len(self.named("better")) < len(self.references)

    @property
    def line(self) -> str:
        """All of it in one line, the verdict in capitals where the controller is worse."""
        own = self.own
        interval = "" if np.isnan(own.low) else f" [{rounded(own.low)}, {rounded(own.high)}]"
        count = len(self.costs[self.agent])
        starts = f"over {count} start state{'s' * (count != 1)}"
        others = ", ".join(
            f"{reference.name} {rounded(reference.cost.mean)}" for reference in self.references
        )
        kept = f" with {self.kept}" if self.kept else ""
        parts = [f"final cost {rounded(own.mean)}{interval} {starts}{kept}", others, self._verdicts()]
        line = f"{parts[0]}; {parts[1]}: {parts[2]}" if others else parts[0]
        for name, reason in self.left_out.items():
            line += f"; {name} left out, {reason}"
        return line + ("; try: " + "; or ".join(self.advice) if self.advice else "")

    def _verdicts(self) -> str:
        if not self.needs_advice:
            return "better than each of them" if len(self.references) > 1 else "better"
        said = {"worse": "WORSE than", "no difference": "NO DIFFERENCE from", "better": "better than"}
        found = ((words, self.named(verdict)) for verdict, words in said.items())
        return ", ".join(f"{words} {' and '.join(names)}" for words, names in found if names)

    def _finite(self, name: str) -> Array:
        costs = np.nan_to_num(np.asarray(self.costs[name], np.float64), nan=LARGEST_COST)
        return np.clip(costs, -LARGEST_COST, LARGEST_COST)


def _verdict_of_ranks(differences: Array, diverged_more: int) -> str:
    """By the signed ranks of paired differences (n,), where the trained one diverged so many times more often."""
    if not differences.any():
        return "no difference"
    tested: Any = wilcoxon(differences)
    if tested.pvalue > LARGEST_P:
        return "no difference"
    ranks = rankdata(np.abs(differences)) * np.sign(differences)
    better = float(ranks.sum()) < 0.0
    if diverged_more and better == (diverged_more > 0):
        return "no difference"
    return "better" if better else "worse"
