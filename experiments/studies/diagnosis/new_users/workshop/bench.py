"""What the robots of this folder share: a loop that integrates between samples, sensors, and files of columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from experiments.studies.diagnosis.new_users.cases import Case

TURN, DEG = 2.0 * np.pi, 180.0 / np.pi
Values = Mapping[str, float]
Slope = Callable[[np.ndarray, np.ndarray], np.ndarray]
Write = Callable[[Path, Values, Any], None]


@dataclass(frozen=True)
class Robot:
    """One robot of a new user.

    Attributes:
        system: Description of it, in the folder ``robots``.
        nominal: Values that the description declares.
        spread: Their declared standard deviations; a unit is off by half of them.
        write: Writes the log of a unit with these parameters to a path, with draws from a generator.
        cases: Its logs by name.
        suffix: Of a log; empty where a log is a folder.
        corrected: What an engineer corrects in the sidecar, because `inspect` asks for it: keys of channels.
    """

    system: str
    nominal: dict[str, float]
    spread: dict[str, float]
    write: Write
    cases: dict[str, Case] = field(default_factory=dict)
    suffix: str = ".csv"
    corrected: dict[str, dict[str, Any]] = field(default_factory=dict)


def looped(
    slope: Slope,
    controller: Callable[[int, np.ndarray], Sequence[float]],
    start: Sequence[float],
    rate: float,
    ticks: int,
    *,
    delay: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return states (n, S) at the ticks of a controller, and its commands (n, M).

    Args:
        slope: Derivative of the state under a command.
        controller: Command of a tick, from its number and the state there.
        start: First state (S,).
        rate: Of the controller [Hz].
        ticks: Number n of them.
        delay: Time from a tick until its command acts [s]; below one period.
    """
    x, period = np.array(start, float), 1.0 / rate
    states, commands = np.zeros((ticks, len(x))), []
    acting = np.asarray(controller(0, x), float)
    for k in range(ticks):
        states[k] = x
        commands.append(np.asarray(controller(k, x), float))
        for seconds, u in ((delay, acting), (period - delay, commands[-1])):
            if seconds > 0.0:
                found = solve_ivp(
                    lambda _, y, u=u: slope(y, u), (0.0, seconds), x, "LSODA", rtol=1e-8, atol=1e-10
                )
                x = found.y[:, -1]
        acting = commands[-1]
    return states, np.array(commands)


def read(x: np.ndarray, step: float, noise: float, rng: Any) -> np.ndarray:
    """Return what a sensor of these steps and noise shows (n,); a step of 0 is none."""
    x = x + noise * rng.standard_normal(x.shape)
    return step * np.round(x / step) if step else x


def held(rng: Any, n: int, shortest: int, longest: int, level: float) -> np.ndarray:
    """Return random levels (n,), each held for some samples."""
    return np.repeat(rng.uniform(-level, level, n), rng.integers(shortest, longest, n))[:n]


def dry(level: float, speed: float, sharp: float) -> float:
    """Return dry friction that grows over a speed ``sharp``."""
    return level * np.tanh(speed / sharp) if level else 0.0


def write_columns(path: Path, columns: Mapping[str, tuple[np.ndarray, int]], separator: str = ",") -> None:
    """Write columns of values (n,), each with its decimals; decimals have a comma where ``separator`` is ``;``."""
    cells = [[f"{v:.{places}f}" for v in values] for values, places in columns.values()]
    rows = [separator.join(columns), *(separator.join(row) for row in zip(*cells, strict=True))]
    text = "\n".join(rows) + "\n"
    path.write_text(text.replace(".", ",") if separator == ";" else text, encoding="utf-8")
