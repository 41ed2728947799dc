"""Names and colours of the methods, the same in every figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

STYLE = str(files("deepkoco.output").joinpath("figures.mplstyle"))
REFERENCE_COLOUR = "#555555"
LINES = ("-", "--", ":", "-.")


@dataclass(frozen=True)
class MethodStyle:
    """How a method is drawn.

    Attributes:
        label: In legends and tables.
        colour: Of its lines and bands; from the palette of Okabe and Ito, which colour-blind readers can tell apart.
    """

    label: str
    colour: str


METHODS = {
    "deepkoco": MethodStyle("DeepKoCo", "#0072B2"),
    "dbc": MethodStyle("DBC", "#D55E00"),
    "deepmdp": MethodStyle("DeepMDP", "#009E73"),
    "sac": MethodStyle("SAC", "#CC79A7"),
    "sac_shared": MethodStyle("SAC, shared encoder", "#E69F00"),
    "ppo": MethodStyle("PPO", "#56B4E9"),
    "imitation": MethodStyle("imitation", "#000000"),
}
"""By name of the agent, in the order of legends."""


def method_style(agent: str) -> MethodStyle:
    """How an agent is drawn; one that is not listed gets its own name, in black."""
    return METHODS.get(agent, MethodStyle(agent, "#000000"))


def method_rank(agent: str) -> tuple[int, str]:
    """What to sort agents by."""
    names = list(METHODS)
    return (names.index(agent) if agent in METHODS else len(names), agent)


def variant_line(variant: str, variants: Sequence[str]) -> str:
    """Kind of line of one of the settings that an agent was run with.

    Args:
        variant: What sets it apart.
        variants: All of that agent in a panel.
    """
    return LINES[sorted(variants).index(variant) % len(LINES)]
