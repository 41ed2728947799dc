"""Search spaces of hyper-parameters, files of configs/tuning, and the points that are tried."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import MISSING, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from scipy.stats import qmc
from yaml import YAMLError

from deepkoco.runs.settings import ExperimentError

DIGITS = 3
KINDS = ("uniform", "log_uniform", "integer", "choice")


@dataclass
class Dimension:
    """What is tried of one setting."""

    kind: str = MISSING
    """How values are spread: "uniform", "log_uniform", "integer" (evenly, both ends included) or "choice"."""
    low: float = 0.0
    """Smallest value, unless it is a choice."""
    high: float = 0.0
    """Largest value."""
    values: list[Any] = field(default_factory=list)
    """Of a choice, at least two."""

    def check(self, name: str) -> None:
        """Check that the range is one.

        Args:
            name: Of the setting.

        Raises:
            ExperimentError: It is not.
        """
        if self.kind not in KINDS:
            raise ExperimentError(f'{name}: kind = "{self.kind}"; choose one of {", ".join(KINDS)}')
        if self.kind == "choice":
            if len(self.values) < 2:
                raise ExperimentError(f"{name}: values = {self.values}; give at least two to choose from")
            return
        if not self.low < self.high:
            raise ExperimentError(f"{name}: low = {self.low:g} is not below high = {self.high:g}")
        if self.kind == "log_uniform" and not self.low > 0:
            raise ExperimentError(f"{name}: low = {self.low:g}; a logarithmic range starts above 0")

    def value(self, share: float) -> Any:
        """The value at a share in [0, 1) of the range; of real ones, to three digits."""
        if self.kind == "choice":
            return self.values[int(share * len(self.values))]
        if self.kind == "integer":
            low, high = math.ceil(self.low), math.floor(self.high)
            return low + int(share * (high - low + 1))
        if self.kind == "log_uniform":
            value = self.low * (self.high / self.low) ** share
        else:
            value = self.low + share * (self.high - self.low)
        return float(f"{value:.{DIGITS}g}")


@dataclass
class SearchSpace:
    """What is tuned of an agent, a file of configs/tuning."""

    space: dict[str, Dimension] = MISSING
    """Dotted name of a setting of the agent, such as learning_rate, to what is tried of it."""
    overrides: list[str] = field(default_factory=list)
    """Further settings of every trial, the first one too; {episodes} stands for the episodes of a trial."""

    def check(self) -> None:
        """Check every dimension.

        Raises:
            ExperimentError: One is wrong, or there is none.
        """
        if not self.space:
            raise ExperimentError("space is empty; give at least one setting to tune")
        for name, dimension in self.space.items():
            dimension.check(name)

    def points(self, count: int, seed: int) -> list[dict[str, Any]]:
        """The values of the first trials.

        Trial 0 leaves all settings as they are. The others follow a scrambled Halton sequence, so a larger budget
        adds trials and changes none, and the outcome of one does not depend on when others finish.

        Args:
            count: Trials.
            seed: Of the scrambling.

        Returns:
            For each trial name to value.
        """
        shares = qmc.Halton(len(self.space), rng=seed).random(max(count - 1, 0))
        return [{}] + [
            {name: own.value(share) for (name, own), share in zip(self.space.items(), row, strict=True)}
            for row in shares.tolist()
        ]


def load_search_space(path: Path) -> SearchSpace:
    """Read a search space.

    Args:
        path: YAML file with the fields of `SearchSpace`.

    Returns:
        The space, checked.

    Raises:
        ExperimentError: There is no such file, or it is wrong.
    """
    try:
        stored = OmegaConf.merge(OmegaConf.structured(SearchSpace), OmegaConf.load(path))
        found = OmegaConf.to_object(stored)
    except FileNotFoundError as error:
        known = ", ".join(sorted(other.stem for other in path.parent.glob("*.yaml")))
        raise ExperimentError(f"{path}: no such search space; there are {known or 'none'}") from error
    except (OmegaConfBaseException, YAMLError, OSError, ValueError) as error:
        raise ExperimentError(f"{path}: {' '.join(str(error).split())}") from error
    assert isinstance(found, SearchSpace)
    try:
        found.check()
    except ExperimentError as error:
        raise ExperimentError(f"{path}: {error}") from error
    return found


def as_overrides(values: dict[str, Any]) -> list[str]:
    """Settings of an agent as arguments of `deepkoco train`.

    Args:
        values: Dotted name to value.
    """
    return [f"agent.{name}={_text(value)}" for name, value in values.items()]


def _text(value: Any) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{','.join(map(_text, value))}]"
    return repr(value) if isinstance(value, float) else str(value)
