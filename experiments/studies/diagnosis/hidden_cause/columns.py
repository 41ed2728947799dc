"""Columns of the table of entrants, each with an interval, from the rows of the cases."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.studies.diagnosis.hidden.measures import wilson
from experiments.studies.diagnosis.hidden_cause.judge import FAILED
from experiments.studies.diagnosis.hidden_cause.kinds import NOTHING, UNKNOWN
from experiments.studies.diagnosis.hidden_cause.rows import Row

RESAMPLES = 2000
SHARES = {
    "top-1 in class": "first cause right, of hidden causes in the catalogue",
    "false alarms": 'anything but "nothing", of healthy units',
    "outside right": '"unknown" or the family, of hidden causes outside the catalogue',
}
MEDIANS = {
    "held-out error / as given": "error on held-out windows over that of the model as given, median of the cases",
    "seconds": "processor seconds of a case, median",
}


def entrants_of(rows: Sequence[Row]) -> list[str]:
    """Return the entrants in the order of their first rows."""
    return list(dict.fromkeys(r["entrant"] for r in rows))


def columns(rows: Sequence[Row]) -> dict[str, dict[str, dict[str, Any]]]:
    """Return entrant -> column -> value with interval."""
    return {entrant: _of_one([r for r in rows if r["entrant"] == entrant]) for entrant in entrants_of(rows)}


def _of_one(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    judged = [r for r in rows if r["right"] != ""]
    healthy = [r for r in judged if r["kind"] == NOTHING]
    hidden = [r for r in judged if r["kind"] != NOTHING]
    named = [r for r in healthy if r["name"] not in (NOTHING, UNKNOWN, FAILED)]
    return {
        "top-1 in class": wilson([r["right"] == "1" for r in hidden if r["inside"] == "1"]),
        "false alarms": {**wilson([r["right"] != "1" for r in healthy]), "with a name": len(named)},
        "outside right": wilson([r["right"] == "1" for r in hidden if r["inside"] != "1"]),
        "held-out error / as given": median([ratio(r) for r in rows if r["error_given"] != "nan"]),
        "seconds": median([float(r["cpu_s"]) for r in rows]),
        "failed": {"count": sum(r["name"] == FAILED for r in rows), "of": len(rows)},
    }


def ratio(row: Row) -> float:
    """Held-out error over that of the model as given; 1 where an entrant failed, because its user keeps that model."""
    error, given = float(row["error"]), float(row["error_given"])
    if math.isnan(error) or math.isinf(given):
        return 1.0
    return error / max(given, 1e-300)


def median(values: Sequence[float]) -> dict[str, Any]:
    """Median with its 95 % interval by bootstrap over the cases."""
    if not values:
        return {"value": None, "low": None, "high": None, "of": 0}
    array = np.array(values)
    picks = np.random.default_rng(0).integers(0, len(array), (RESAMPLES, len(array)))
    # An order statistic: a median between a number and infinity would be no number.
    medians = np.sort(array[picks], 1)[:, len(array) // 2]
    low, high = np.quantile(medians, [0.025, 0.975], method="nearest")
    return {
        "value": float(np.sort(array)[len(array) // 2]),
        "low": float(low),
        "high": float(high),
        "of": len(array),
    }


def table_of(found: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> str:
    """Return the columns as text, in Markdown."""
    names = [*SHARES, *MEDIANS, "failed"]
    lines = ["| entrant | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for entrant, own in found.items():
        lines.append(f"| {entrant} | " + " | ".join(_cell(own[n]) for n in names) + " |")
    return "\n".join(lines) + "\n"


def _cell(value: Mapping[str, Any]) -> str:
    if "value" in value:
        if value["value"] is None:
            return "no case"
        return f"{value['value']:.3g} [{value['low']:.3g}, {value['high']:.3g}]"
    if not value["of"]:
        return "no case"
    text = f"{value['count']} of {value['of']}"
    return text + (f" [{value['low']:.2f}, {value['high']:.2f}]" if "low" in value else "")
