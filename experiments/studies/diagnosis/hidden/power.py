"""Detection and naming against strength, and what was named for what was hidden."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from deepkoco.diagnose.causes import kind_of
from experiments.studies.diagnosis.hidden.measures import (
    Row,
    classes_of,
    detected,
    first_class,
    strength_of,
    wilson,
)

EDGES = (0.07, 0.1, 0.14, 0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.2, 4.5)  # ES
NOTHING, UNKNOWN = "nothing", "unknown"
HITS = {
    "detected": detected,
    "true cause in the first class": lambda row: row["hidden"] in first_class(row),
    "true cause named first": lambda row: first_class(row)[:1] == [row["hidden"]],
}


def studies(rows: Sequence[Row]) -> Iterator[tuple[tuple[str, str], list[Row]]]:
    """Rows of each system and condition."""

    def key(row: Row) -> tuple[str, str]:
        return row["system"], row["condition"]

    for which, group in groupby(sorted(rows, key=key), key):
        yield which, list(group)


def power(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Shares of single causes by strength: one line per study, measure and bin, with Wilson's interval."""
    result = []
    for (system, condition), own in studies(rows):
        singles = [row for row in own if row["kind"] == "single"]
        for measure, hit in HITS.items():
            for low, high in pairwise(EDGES):
                inside = [row for row in singles if low <= strength_of(row) < high]
                if inside:
                    found = wilson([hit(row) for row in inside])
                    middle = float(np.exp(np.mean([np.log(strength_of(row)) for row in inside])))
                    line = {"system": system, "condition": condition, "measure": measure}
                    result.append({**line, "ES_from": low, "ES_to": high, "ES": round(middle, 4), **found})
    return result


def confusion(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """How often which kind was named first for which kind that was hidden, sites left out.

    Controls are hidden ``nothing``; cases outside the catalogue are included, pairs are not.
    """
    counts: Counter[tuple[str, str, str, str]] = Counter()
    for row in rows:
        if row["kind"] == "pair":
            continue
        hidden = kind_of(row["hidden"]) if row["hidden"] else NOTHING
        names = first_class(row)
        named = kind_of(names[0]) if names else UNKNOWN if row["verdict"] == UNKNOWN else NOTHING
        counts[row["system"], row["condition"], hidden, named] += 1
    keys = ("system", "condition", "hidden", "named")
    return [{**dict(zip(keys, which, strict=True)), "cases": n} for which, n in sorted(counts.items())]


def extra_names(rows: Sequence[Row]) -> dict[str, Any]:
    """Single causes beside which a further cause was named that is not there."""
    seen = [row for row in rows if row["kind"] == "single" and classes_of(row)]
    return wilson([any(row["hidden"] not in members for members in classes_of(row)) for row in seen])
