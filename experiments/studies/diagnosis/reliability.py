"""What stated probabilities are worth: how often causes of each stated probability were the hidden ones.

    python -m experiments.studies.diagnosis.reliability --rows runs/hidden_effects --out results/diagnose/reliability

Reads the rows of `experiments.studies.diagnosis.hidden_effects`; rows of before probabilities were kept are left out.
Every probability that a report states is one statement: a cause of the catalogue, "nothing", or "unknown". It is true
where that was hidden. A method is calibrated where statements of 0.9 are true in nine of ten cases.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from deepkoco.output.whole_file import whole_file, write_whole_text
from experiments.studies.diagnosis.hidden.measures import wilson
from experiments.studies.diagnosis.hidden.pictures import STYLE

EDGES = (0.0, 0.05, 0.2, 0.5, 0.8, 0.9, 0.99, 1.0)  # of stated probabilities in the table
Row = Mapping[str, Any]
Statement = tuple[float, bool]


def statements(row: Row) -> list[Statement]:
    """Return each probability that the answer to a case states, and whether it is true.

    Args:
        row: Of the study of hidden effects.
    """
    hidden = set(filter(None, str(row["hidden"]).split(" + ")))
    listed = row["kind"] in ("single", "pair")
    found = []
    for k, place in enumerate(json.loads(row["probabilities"])):
        for name, p in place.items():
            if name == "nothing":
                # After a first cause, "nothing" means that no further one is missing.
                true = len(hidden) <= k
            elif name == "unknown":
                true = bool(hidden) and not listed
            else:
                true = name in hidden and listed
            found.append((float(p), true))
    return found


def binned(stated: Iterable[Statement]) -> list[dict[str, Any]]:
    """Return, for each range of stated probabilities, their mean, and how many statements are true.

    Args:
        stated: Probabilities, each with whether it is true.
    """
    stated, found = list(stated), []
    for low, high in itertools.pairwise(EDGES):
        inside = [(p, hit) for p, hit in stated if low < p <= high]
        mean = sum(p for p, _ in inside) / len(inside) if inside else None
        found.append({"from": low, "to": high, "stated": mean, **wilson([hit for _, hit in inside])})
    return found


def table_of(bins: Sequence[Mapping[str, Any]]) -> str:
    """Return the ranges as a table in Markdown."""
    lines = ["| stated | mean | true | of | share, 95 % interval |", "|---|---|---|---|---|"]
    for b in bins:
        mean = "" if b["stated"] is None else f"{b['stated']:.3f}"
        share = f"{b['count'] / b['of']:.2f} [{b['low']:.2f}, {b['high']:.2f}]" if b["of"] else ""
        lines.append(f"| {b['from']:g} to {b['to']:g} | {mean} | {b['count']} | {b['of']} | {share} |")
    return "\n".join(lines) + "\n"


def draw(bins: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw the share of true statements against the stated probability, with Wilson's 95 % intervals.

    Args:
        bins: As given by :func:`binned`.
        path: PNG to write, all or nothing.
    """
    full = [b for b in bins if b["of"]]
    shares = [b["count"] / b["of"] for b in full]
    error = [
        [max(s - b["low"], 0.0) for s, b in zip(shares, full, strict=True)],
        [max(b["high"] - s, 0.0) for s, b in zip(shares, full, strict=True)],
    ]
    with plt.rc_context(fname=STYLE):
        figure, axis = plt.subplots(figsize=(4.6, 4.0))
        axis.plot([0.0, 1.0], [0.0, 1.0], color="#8a8a8a", lw=1, ls="--", label="calibrated")
        axis.errorbar([b["stated"] for b in full], shares, error, marker="o", capsize=2, label="diagnosis")
        for b, share in zip(full, shares, strict=True):
            axis.annotate(
                f"{b['of']}", (b["stated"], share), (5, -10), textcoords="offset points", fontsize=8
            )
        axis.set(
            xlim=(-0.03, 1.05), ylim=(-0.03, 1.05), xlabel="stated probability", ylabel="share that is true"
        )
        axis.legend(loc="upper left")
        with whole_file(path) as partial:
            figure.savefig(partial, format="png", dpi=150)
        plt.close(figure)


def gather(folder: Path) -> list[Row]:
    """Return all rows of a folder in which probabilities are kept.

    Args:
        folder: Folder with CSV files of the study of hidden effects.
    """
    rows: list[Row] = []
    for path in sorted(folder.glob("*.csv")):
        text = path.read_text(encoding="utf-8")
        # A row that is being written has no end yet.
        rows += csv.DictReader(text[: text.rfind("\n") + 1].splitlines())
    return [row for row in rows if row.get("probabilities")]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table and the curve."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", type=Path, required=True, help="folder with rows of hidden effects")
    parser.add_argument("--out", type=Path, required=True, help="folder of the table and the curve")
    args = parser.parse_args(arguments)
    rows = gather(args.rows)
    if not rows:
        parser.error(f"{args.rows} has no rows with probabilities; run the study of hidden effects first")
    bins = binned(s for row in rows for s in statements(row))
    args.out.mkdir(parents=True, exist_ok=True)
    columns = list(bins[0])
    lines = [
        ",".join(columns),
        *(",".join("" if b[c] is None else f"{b[c]:g}" for c in columns) for b in bins),
    ]
    write_whole_text(args.out / "reliability.csv", "\n".join(lines) + "\n")
    draw(bins, args.out / "reliability.png")
    sys.stdout.write(f"{len(rows)} cases\n{table_of(bins)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
