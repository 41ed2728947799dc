"""The best possible cost and that of a random policy, start state by start state.

Start states differ more than agents do, and a run evaluates on few. What it pays is therefore held against the
optimum of its own start states where that is stored, and else against the mean over all that are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.runs.settings import ExperimentError, TaskConfig
from experiments.studies.learning.optimum import load_task

REFERENCES = Path(__file__).resolve().parents[4] / "results" / "optimum" / "references"
COLUMNS = ("seed", "purpose", "episode", "optimum", "optimum_without_delay", "random")


@dataclass(frozen=True)
class References:
    """What is known of a task.

    Attributes:
        table: One row per start state, with `COLUMNS`.
    """

    table: pd.DataFrame

    def mean(self, column: str) -> float:
        """Mean over all start states of one of `COLUMNS`."""
        return float(self.table[column].to_numpy().mean())

    @property
    def optimum(self) -> float:
        """Mean cost of the best controller with one step of input delay, as DeepKoCo has it."""
        return self.mean("optimum")

    @property
    def optimum_without_delay(self) -> float:
        """Mean cost of the best controller that acts at once."""
        return self.mean("optimum_without_delay")

    @property
    def random(self) -> float:
        """Mean cost of actions drawn evenly between their limits at every step."""
        return self.mean("random")

    @property
    def episodes(self) -> int:
        """Start states."""
        return len(self.table)

    def optimum_of(self, seed: int, purpose: str, count: float) -> float:
        """Mean optimum of the start states that a run evaluates on; of all where these are not stored.

        Args:
            seed: Of the run.
            purpose: "evaluation" during training, "final" at its end.
            count: Noise-free episodes.
        """
        table = self.table
        own = (
            (table["seed"] == seed) & (table["purpose"] == purpose) & (table["episode"] < count)
        ).to_numpy()
        optimum = table["optimum"].to_numpy()[own]
        return float(optimum.mean()) if 0 < optimum.size == count else self.optimum


def load_references(task: TaskConfig, folder: Path = REFERENCES) -> References | None:
    """Read what is stored of a task.

    Args:
        task: The task of a run.
        folder: Of `experiments.studies.learning.reference_costs`.

    Returns:
        None if nothing is stored, or the task is not that of configs/task, such as one with other arguments.

    Raises:
        ExperimentError: The file cannot be read.
    """
    path = folder / f"{task.name}.csv"
    if not path.is_file():
        return None
    try:
        known = load_task(task.name).task
    except ExperimentError:
        return None
    if replace(known, system=task.system) != task:  # what copies are of does not change the optimum
        return None
    try:
        table = pd.read_csv(path)
        return References(table.loc[:, list(COLUMNS)].astype({name: np.float64 for name in COLUMNS[3:]}))
    except (OSError, ValueError, KeyError) as error:
        reason = " ".join(str(error).split())
        raise ExperimentError(
            f"{path}: not what experiments.studies.learning.reference_costs writes: {reason}"
        ) from error
