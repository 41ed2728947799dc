"""The delays of the study: constant, random, in any order, and fitted to measured ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.graph.episodes.fitting.mixture_fit import fit_mixture


@dataclass(frozen=True)
class Law:
    """Delays of observations and commands.

    Attributes:
        name: As in the tables.
        kind: "constant", "random" or "measured".
        sensing: Of observations [s].
        actuation: Of commands [s].
        in_order: Messages cannot overtake each other.
        shift: Whole steps after which the first command acts; None for other delays than whole steps.
    """

    name: str
    kind: str
    sensing: Any
    actuation: Any
    in_order: bool = True
    shift: int | None = None


PAIRS = ((0, 0), (1, 0), (1, 1), (2, 2), (3, 3), (4, 4), (5, 5), (10, 0), (0, 10), (10, 10), (2.5, 2.5))
"""Constant delays of observations and of commands, in steps."""
RANDOM: dict[str, dict[str, Any]] = {
    "uniform 0-4": {"law": "uniform", "low": 0.0, "high": 4.0},
    "uniform 0-10": {"law": "uniform", "low": 0.0, "high": 10.0},
    "lognormal 2": {"law": "lognormal", "median": 2.0, "sigma": 0.5},
}
"""Laws of both delays, in steps."""
TIMES = {"low", "high", "median"}  # the others are numbers without unit


def constant_laws(step: float) -> list[Law]:
    """Constant delays, written "observation+command" in steps.

    Args:
        step: Seconds per step of the task.
    """
    laws = []
    for sensing, actuation in PAIRS:
        shift = actuation if isinstance(actuation, int) else None
        name = f"{sensing}+{actuation}"
        laws.append(Law(name, "constant", round(sensing * step, 9), round(actuation * step, 9), True, shift))
    return laws


def random_laws(step: float) -> list[Law]:
    """The same law for observations and commands, in order and in any order.

    Args:
        step: Seconds per step of the task.
    """
    laws = []
    for name, law in RANDOM.items():
        scaled = {key: value * step if key in TIMES else value for key, value in law.items()}
        laws += [
            Law(name, "random", scaled, scaled),
            Law(f"{name}, any order", "random", scaled, scaled, False),
        ]
    return laws


SENSING = {
    "pendulum": ("comp__sensor", "comm__state__agent"),
    "vx300s": ("comp__armsensor", "comm__armsensor__planner"),
}
ACTUATION = {
    "pendulum": ("comp__agent", "comm__action__actuator", "comp__actuator", "comm__actuator__world"),
    "vx300s": (
        "comp__planner",
        "comm__planner__controller",
        "comp__controller",
        "comm__controller__armactuator",
    ),
}
FILES = {
    "pendulum 20 Hz": ("pendulum_real_20hz", "pendulum"),
    "pendulum 30 Hz": ("pendulum_real_30hz", "pendulum"),
    "double pendulum 80 Hz": ("double_pendulum_real_80hz", "pendulum"),
    "arm 3 Hz": ("vx300s_real_3hz", "vx300s"),
}
STRETCHED = 6.0
"""Mean of the delays of observation and command together in a stretched law [steps]."""


def measured_laws(data: Path, step: float) -> list[Law]:
    """Laws fitted to measured delays, as they are and stretched to a mean of `STRETCHED` steps.

    Args:
        data: Folder of the measured delays.
        step: Seconds per step of the task.

    Returns:
        Two for each file.
    """
    laws = []
    for name, (stem, kind) in FILES.items():
        samples = np.load(data / f"{stem}.npz")
        sensing, actuation = (_chain(samples, chain[kind]) for chain in (SENSING, ACTUATION))
        stretch = STRETCHED * step / (sensing.mean() + actuation.mean())
        for title, factor in ((name, 1.0), (f"{name}, x {stretch:.1f}", stretch)):
            laws.append(
                Law(title, "measured", fit_mixture(factor * sensing), fit_mixture(factor * actuation))
            )
    return laws


def _chain(samples: Mapping[str, np.ndarray], channels: tuple[str, ...]) -> np.ndarray:
    """Delays of a chain of channels [s]: sums of samples of the same time, without the first and without stalls.

    The first fiftieth of a channel is its warm-up. A stall hits all channels at once, which a law of single messages
    cannot say; sums five times above their 99 % quantile are left out.
    """
    parts = [np.asarray(samples[channel], float) for channel in channels]
    parts = [part[len(part) // 50 :] for part in parts]
    length = min(map(len, parts))
    total = np.sum([part[np.linspace(0, len(part) - 1, length).astype(int)] for part in parts], axis=0)
    return total[total < 5.0 * np.quantile(total, 0.99)]
