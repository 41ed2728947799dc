"""Measures of the study from its rows, each with its count, as the table of goals asks for them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]
CLEAR = 0.3  # ES from which naming counts
SURE = 0.2  # ES from which detection has to be complete


def measures(rows: Sequence[Row]) -> dict[str, Any]:
    """Every line of the table "What it must reach"."""
    controls = [r for r in rows if r["kind"] == "control"]
    singles = [r for r in rows if r["kind"] == "single"]
    pairs = [r for r in rows if r["kind"] == "pair"]
    unlisted = [r for r in rows if r["kind"] == "outside"]
    clear = [r for r in singles if strength_of(r) >= CLEAR]
    weak = [r for r in singles if 0.1 <= strength_of(r) < SURE]
    sure = [r for r in singles if strength_of(r) >= SURE]
    seen = [r for r in singles if classes_of(r)]
    loud = [r for r in unlisted if float(r["chi2_before"]) > 1.2]
    errors, covered = _parameters(clear)
    judged = [r for r in [*singles, *pairs] if r["oracle_gain"] not in ("", None) and classes_of(r)]
    given = [r for r in rows if r["against_given"] not in ("", None)]
    return {
        "false_alarms": wilson([r["verdict"] != "nothing" for r in controls]),
        "detected_ES_0.1_to_0.2": wilson([detected(r) for r in weak]),
        "detected_ES_from_0.2": wilson([detected(r) for r in sure]),
        "top_1_in_class": wilson([r["hidden"] in first_class(r) for r in clear]),
        "exact_top_1": wilson([first_class(r)[:1] == [r["hidden"]] for r in clear]),
        "true_cause_in_reported_set": wilson([r["hidden"] in named(r) for r in seen]),
        "set_size": _mean([len(first_class(r)) for r in seen]),
        "pairs_both_named": wilson([all(n in named(r) for n in r["hidden"].split(" + ")) for r in pairs]),
        "outside_called_unknown": wilson([r["verdict"] == "unknown" for r in loud]),
        "outside_named_wrongly": wilson([r["verdict"] in ("cause", "ambiguous") for r in loud]),
        "parameter_error_median": _median(errors),
        "interval_coverage": wilson(covered),
        "held_out_gain_of_oracle": wilson([_near_oracle(r) for r in judged]),
        "worse_than_given_by_2_percent": wilson([float(r["against_given"]) > 1.02 for r in given]),
        "cpu_s": _median([float(r["cpu_s"]) for r in rows]),
    }


def strength_of(row: Row) -> float:
    """ES of a case; of several effects the largest."""
    return max((float(x) for x in str(row["ES"]).split(" + ") if x), default=0.0)


def classes_of(row: Row) -> list[list[str]]:
    """Names of each finding, first finding first; none where nothing is named."""
    found = json.loads(row["classes"])
    return [] if found == [["unknown"]] else found


def first_class(row: Row) -> list[str]:
    """Names of the first finding."""
    found = classes_of(row)
    return found[0] if found else []


def named(row: Row) -> set[str]:
    """Every name of every finding."""
    return {name for members in classes_of(row) for name in members}


def detected(row: Row) -> bool:
    """Whether the diagnosis saw that something is wrong."""
    return row["verdict"] in ("cause", "ambiguous", "unknown")


def _near_oracle(row: Row) -> bool:
    """Whether what is left of the held-out error is at most 5 % of the oracle's gain more than the oracle leaves."""
    best = float(row["oracle_gain"])
    return float(row["gain"]) >= best - max(0.05 * abs(best), 0.005)


def _parameters(rows: Sequence[Row]) -> tuple[list[float], list[bool]]:
    errors, covered = [], []
    for row in rows:
        for p in json.loads(row["parameters"]):
            null = 1.0 if p["name"].endswith(".factor") else 0.0
            size = abs(p["true"] - null)
            if size > 0.0:
                errors.append(abs(p["value"] - p["true"]) / size)
                covered.append(p["low"] <= p["true"] <= p["high"])
    return errors, covered


def wilson(hits: Sequence[bool]) -> dict[str, Any]:
    """Count, number and Wilson's 95 % interval of a share."""
    n, k = len(hits), sum(map(bool, hits))
    if n == 0:
        return {"count": 0, "of": 0, "share": None, "low": None, "high": None}
    z, p = 1.96, k / n
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    reach = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    low, high = max(middle - reach, 0.0), min(middle + reach, 1.0)
    return {"count": k, "of": n, "share": round(p, 4), "low": round(low, 4), "high": round(high, 4)}


def _mean(values: Sequence[float]) -> dict[str, Any]:
    return {"value": round(sum(values) / len(values), 3) if values else None, "of": len(values)}


def _median(values: Sequence[float]) -> dict[str, Any]:
    if not values:
        return {"value": None, "of": 0}
    ordered = sorted(values)
    middle = len(ordered) // 2
    value = ordered[middle] if len(ordered) % 2 else 0.5 * (ordered[middle - 1] + ordered[middle])
    return {"value": round(value, 4), "of": len(values)}
