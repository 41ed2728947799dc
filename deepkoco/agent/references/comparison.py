"""Costs of a trained controller against those of references, as paired differences with their intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.koopman.exported import Array
from deepkoco.pages.units import rounded

ZERO, RANDOM, EDMDC = "zero action", "random episodes", "EDMDc + planner"
LARGEST_COST = 1e100
"""What a cost that is infinite or no number counts as; the square of its spread must be a number."""


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
    """

    name: str
    cost: MeanCost
    difference: MeanCost

    @property
    def verdict(self) -> str:
        """How the trained controller does beside it: "better", "worse" or "no difference" at 95 %."""
        if self.difference.high < 0:
            return "better"
        return "worse" if self.difference.low > 0 else "no difference"


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
        return [Reference(name, MeanCost.of(c), MeanCost.of(own - c)) for name, c in costs.items()]

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
