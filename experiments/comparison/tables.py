"""Final costs of the methods, and how much training they had."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from deepkoco.runs.aggregate import bootstrap_interval, interquartile_mean
from experiments.comparison.references import References
from experiments.comparison.runs import COST, METHOD, OF_A_RUN, PANEL, groups


def last_evaluations(table: pd.DataFrame) -> pd.DataFrame:
    """The last evaluation of every run.

    Args:
        table: As given by `runs.evaluations`.
    """
    return table.sort_values("steps").groupby(OF_A_RUN, sort=True).tail(1).sort_values(OF_A_RUN)


def final_costs(table: pd.DataFrame, references: Mapping[str, References | None]) -> pd.DataFrame:
    """Noise-free cost at the end, one row per panel and method.

    Args:
        table: As given by `runs.evaluations`.
        references: By task.

    Returns:
        n seeds, how many are unfinished, interquartile mean with its interval, mean, median, best and worst; the
        noise-free episodes behind each seed's cost; optimum and cost of a random policy; and how much training there
        was: fewest episodes, steps and updates of a seed, mean seconds.
    """
    rows = []
    for names, own in groups(last_evaluations(table), [*PANEL, *METHOD]):
        costs = own[COST].to_numpy(float)
        low, high = bootstrap_interval(costs)
        counts = ("evaluation/episodes", "episodes", "steps", "updates")
        least = {name: int(own[name].to_numpy().min()) for name in counts}
        reference = references.get(names["task"])
        rows.append(
            {
                **names,
                "n": costs.size,
                "unfinished": int((~own["finished"].to_numpy(bool)).sum()),
                "iqm": float(interquartile_mean(costs)),
                "low": low,
                "high": high,
                "mean": costs.mean(),
                "median": np.median(costs),
                "best": costs.min(),
                "worst": costs.max(),
                "evaluation_episodes": least["evaluation/episodes"],
                "optimum": reference.optimum if reference else float("nan"),
                "random": reference.random if reference else float("nan"),
                "episodes": least["episodes"],
                "steps": least["steps"],
                "updates": least["updates"],
                "seconds": float(own["seconds"].to_numpy().mean()),
            }
        )
    return pd.DataFrame(rows)
