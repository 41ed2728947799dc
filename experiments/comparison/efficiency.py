"""How many episodes and steps an agent needs to come near the optimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from deepkoco.runs.aggregate import RESAMPLES
from experiments.comparison.references import References
from experiments.comparison.runs import COST, METHOD, OF_A_RUN, PANEL, groups

CRITERIA = ("reached", "kept")
COUNTED = ("episodes", "steps")


def first_and_kept(costs: np.ndarray, targets: np.ndarray) -> tuple[int | None, int | None]:
    """Find the evaluations at which a target is reached, and from which on it is kept.

    Args:
        costs: Of a run's evaluations (k,), in their order.
        targets: Of each of them (k,).

    Returns:
        Index of the first evaluation at or below its target, and of the first from which on all are; None if never.
    """
    met = costs <= targets
    reached = int(np.argmax(met)) if met.any() else None
    kept = len(met) - int(np.argmin(met[::-1])) if not met.all() else 0
    return reached, kept if kept < len(met) else None


def times_to_target(
    table: pd.DataFrame, references: Mapping[str, References | None], factors: Sequence[float]
) -> pd.DataFrame:
    """For every run the episodes and steps to a multiple of the optimum.

    An evaluation is held against the optimum of its own start states where that is stored. A run that never comes
    there counts as infinite, also one that is not finished.

    Args:
        table: As given by `runs.evaluations`.
        references: By task; tasks without one are left out.
        factors: Multiples of the optimum.

    Returns:
        One row per run and factor: `OF_A_RUN`, factor, finished, trained_episodes, trained_steps, and for each
        criterion and count a column such as reached_episodes.
    """
    rows = []
    for names, own in groups(table, OF_A_RUN):
        own = own.sort_values("steps")
        reference = references.get(names["task"])
        if reference is None:
            continue
        optimum = np.array(
            [
                reference.optimum_of(seed, "final" if last else "evaluation", count)
                for seed, last, count in zip(
                    own["seed"], own["last"], own["evaluation/episodes"], strict=True
                )
            ]
        )
        for factor in factors:
            found = first_and_kept(own[COST].to_numpy(), factor * optimum)
            times = {
                f"{criterion}_{count}": np.inf if index is None else float(own[count].iloc[index])
                for criterion, index in zip(CRITERIA, found, strict=True)
                for count in COUNTED
            }
            trained = {f"trained_{count}": own[count].iloc[-1] for count in COUNTED}
            rows.append({**names, "finished": own["finished"].iloc[0], "factor": factor, **trained, **times})
    columns = [f"{criterion}_{count}" for criterion in CRITERIA for count in COUNTED]
    return pd.DataFrame(
        rows, columns=[*OF_A_RUN, "finished", "factor", "trained_episodes", "trained_steps", *columns]
    )


def censored_median(times: np.ndarray, seed: int = 0) -> tuple[float, float, float]:
    """Median over seeds and its 95 % percentile bootstrap interval, where some seeds never arrive.

    Args:
        times: Of each seed (n,); infinite where it never arrived.
        seed: Of the resampling.

    Returns:
        Median, lower and upper limit. Each is infinite where so many seeds never arrive; a median between one that
        does and one that does not is infinite too. The limits are NaN for a single seed.
    """
    middle = float(_median(times[None])[0])
    if times.size < 2:
        return middle, float("nan"), float("nan")
    drawn = np.random.default_rng(seed).integers(times.size, size=(RESAMPLES, times.size))
    # Order statistics: interpolation between a finite and an infinite value would be no number.
    medians = np.sort(_median(times[drawn]))
    low, high = medians[int(0.025 * RESAMPLES)], medians[int(np.ceil(0.975 * RESAMPLES)) - 1]
    return middle, float(low), float(high)


def _median(times: np.ndarray) -> np.ndarray:
    """Median of each row (..., n)."""
    ordered, count = np.sort(times, axis=-1), times.shape[-1]
    return (ordered[..., (count - 1) // 2] + ordered[..., count // 2]) / 2


def sample_efficiency(times: pd.DataFrame) -> pd.DataFrame:
    """Sum up over seeds.

    Args:
        times: As given by `times_to_target`.

    Returns:
        One row per panel, method, factor and criterion: seeds, how many arrived, how many are unfinished, the
        fewest trained episodes, and for episodes and steps the median with low and high.
    """
    rows = []
    for names, own in groups(times, [*PANEL, *METHOD, "factor"]):
        for criterion in CRITERIA:
            row = {
                **names,
                "criterion": criterion,
                "seeds": len(own),
                "arrived": int(np.isfinite(own[f"{criterion}_episodes"]).sum()),
                "unfinished": int((~own["finished"].to_numpy(bool)).sum()),
                "trained_episodes": own["trained_episodes"].min(),
            }
            for count in COUNTED:
                values = censored_median(own[f"{criterion}_{count}"].to_numpy(float))
                row |= dict(zip((count, f"{count}_low", f"{count}_high"), values, strict=True))
            rows.append(row)
    return pd.DataFrame(rows)
