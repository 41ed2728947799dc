"""The units of the study: what is hidden in each, weak and strong."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import yaml

SYSTEM = "rod_pendulum"
STRENGTHS = ("strong", "weak")
NOTHING = "nothing"  # the control: a unit as the simulator is

# Effect -> strength -> parameters. The largest torque is 2 N m, the weight of the rod 5 N m.
EFFECTS: dict[str, dict[str, dict[str, float]]] = {
    "torque_bias": {"strong": {"effort": 0.5}, "weak": {"effort": 0.2}},
    "gain": {"strong": {"factor": 0.5}, "weak": {"factor": 0.75}},
    "payload": {"strong": {"mass": 0.3}, "weak": {"mass": 0.1}},
    "viscous": {"strong": {"change": 0.15}, "weak": {"change": 0.05}},
    "saturation": {"strong": {"limit": 1.2}, "weak": {"limit": 1.6}},
    "actuation_delay": {"strong": {"delay": 0.12}, "weak": {"delay": 0.06}},
    "coulomb": {"strong": {"torque": 0.4}, "weak": {"torque": 0.15}},
    "dead_zone": {"strong": {"width": 0.8}, "weak": {"width": 0.3}},
}


@dataclass(frozen=True)
class Case:
    """One unit.

    Attributes:
        effect: Name of what is hidden in it.
        strength: "strong" or "weak".
    """

    effect: str
    strength: str

    @property
    def name(self) -> str:
        """Name of the case's folder."""
        return self.effect if self.effect == NOTHING else f"{self.effect}_{self.strength}"

    @property
    def hidden(self) -> Mapping[str, float]:
        """Parameters of the effect."""
        return {} if self.effect == NOTHING else EFFECTS[self.effect][self.strength]

    def unit_file(self) -> str:
        """The unit as UNIT.yaml."""
        effects = {self.effect: dict(self.hidden)} if self.hidden else {}
        content: dict[str, Any] = {"system": SYSTEM, "effects": effects, "seed": 7}
        return yaml.safe_dump(content, sort_keys=False)


def cases(effects: list[str], strengths: list[str]) -> list[Case]:
    """The units of a study, strong ones first."""
    found = [Case(e, s) for s in STRENGTHS if s in strengths for e in effects if e != NOTHING]
    return [*([Case(NOTHING, "")] if NOTHING in effects else []), *found]
