"""Tables, power curves and confusion matrices of the study of hidden effects, from whatever rows there are.

    python -m experiments.hidden_results --rows runs/hidden_effects --out results/diagnose/hidden_effects

Reads every CSV that `experiments.hidden_effects` wrote into a folder and writes one file with all rows, the shares
against strength (CSV and figure), what was named for what was hidden (CSV and a figure per study), and a README
with every measure beside its goal. Run it again when there are more rows.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from deepkoco.output.whole_file import whole_file, write_whole_text
from experiments.hidden.goals import GOALS, bounds, reached, value_of
from experiments.hidden.measures import measures
from experiments.hidden.pictures import draw_confusion, draw_power
from experiments.hidden.power import confusion, extra_names, power, studies
from experiments.hidden_effects import COLUMNS, ResumeError
from experiments.provenance import as_markdown

Row = dict[str, Any]


def gather(folder: Path) -> list[Row]:
    """All rows of the files of a folder, by study and number; a row that is being written is left out.

    Raises:
        ResumeError: A file has other columns, or a case is there twice.
    """
    rows: dict[tuple[str, str, str], Row] = {}
    for path in sorted(folder.glob("*.csv")):
        text = path.read_text(encoding="utf-8")
        for row in csv.DictReader(text[: text.rfind("\n") + 1].splitlines()):
            if tuple(row) != COLUMNS:
                raise ResumeError(f"{path}: has other columns than a study of hidden effects writes")
            case = row["system"], row["condition"], row["seed"]
            if case in rows:
                raise ResumeError(
                    f"{path}: seed {row['seed']} of {row['system']}, {row['condition']} is there twice"
                )
            rows[case] = row
    return [rows[case] for case in sorted(rows, key=lambda case: (case[0], case[1], int(case[2])))]


def table(rows: Sequence[Row]) -> list[str]:
    """Markdown lines: every measure of every study beside its goal; what falls short is bold."""
    found = [(which, measures(own)) for which, own in studies(rows)]
    heads = [f"{system}, {condition}" for (system, condition), _ in found]
    lines = ["| measure | goal | " + " | ".join(heads) + " |", "|---" * (2 + len(heads)) + "|"]
    for goal in GOALS:
        cells = [
            _cell(values[goal.measure], reached(goal, condition, values[goal.measure]))
            for (_, condition), values in found
        ]
        lines.append(f"| {goal.text} | {_goal(goal)} | " + " | ".join(cells) + " |")
    extra = [extra_names(own) for _, own in studies(rows)]
    lines.append(
        "| single causes with a further, false name | | " + " | ".join(_cell(x, None) for x in extra) + " |"
    )
    counts = [str(len(own)) for _, own in studies(rows)]
    lines.append("| cases | | " + " | ".join(counts) + " |")
    return lines


def _goal(goal: Any) -> str:
    least, most = bounds(goal, "clean")
    other = bounds(goal, "other")
    share = goal.measure not in ("set_size", "cpu_s")

    def text(value: float) -> str:
        return f"{100 * value:.3g} %" if share else f"{value:g}"

    parts = [f">= {text(least)}"] if least is not None else []
    parts += [f"<= {text(most)}"] if most is not None else []
    if other[0] != least:
        parts.append("clean; others no goal" if other[0] is None else f"clean, >= {text(other[0])} others")
    return " ".join(parts) if len(parts) < 2 or other[0] != least else ", ".join(parts)


def _cell(found: dict[str, Any], good: bool | None) -> str:
    value = value_of(found)
    if value is None:
        return "–"
    if "share" in found:
        text = f"{found['count']}/{found['of']} ({100 * found['low']:.0f} to {100 * found['high']:.0f} %)"
    else:
        text = f"{value:g} (n {found['of']})"
    return f"**{text}**" if good is False else text


def write_results(rows: Sequence[Row], out: Path) -> None:
    """Write rows, tables, figures and README of all studies."""
    out.mkdir(parents=True, exist_ok=True)
    _csv(out / "rows.csv", COLUMNS, rows)
    curves, matrix = power(rows), confusion(rows)
    _csv(out / "power.csv", tuple(curves[0]) if curves else ("system",), curves)
    _csv(out / "confusion.csv", ("system", "condition", "hidden", "named", "cases"), matrix)
    draw_power(curves, out / "power.png")
    pictures = []
    for (system, condition), own in studies(rows):
        mine = [x for x in matrix if (x["system"], x["condition"]) == (system, condition)]
        name = f"confusion_{system}_{condition}.png"
        draw_confusion(mine, out / name, f"{system}, {condition}: {len(own)} cases, pairs left out")
        pictures.append(f"![{system}, {condition}]({name})")
    seeds = [
        f"| {system} | {condition} | {len(own)} | {min(int(r['seed']) for r in own)} to "
        f"{max(int(r['seed']) for r in own)} | {', '.join(sorted({r['commit'] for r in own}))} |"
        for (system, condition), own in studies(rows)
    ]
    text = "\n".join(
        [
            "# Hidden effects, whole catalogue",
            "",
            "Written by `python -m experiments.hidden_results` from the rows of `experiments.hidden_effects`;",
            "[the study](../README.md) says what is hidden and how. A cell has count, number and Wilson's 95 %",
            "interval; **bold** falls short of the goal. `rows.csv` has one row per case.",
            "",
            *table(rows),
            "",
            "![power](power.png)",
            "",
            "`power.csv` has the shares behind the curves. Rows below are what was hidden, columns what was named",
            "first, joints and channels left out; `confusion.csv` has the counts.",
            "",
            *pictures,
            "",
            "## Seeds and commits",
            "",
            "| system | condition | cases | seeds | commits of the rows |",
            "|---|---|---|---|---|",
            *seeds,
            "",
            "These tables and figures:",
            "",
            as_markdown(),
            "",
        ]
    )
    _replace(out / "README.md", text)


def _csv(path: Path, columns: Sequence[str], rows: Sequence[Row]) -> None:
    with whole_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def _replace(path: Path, text: str) -> None:
    write_whole_text(path, text)


def main(arguments: Sequence[str] | None = None, write: Callable[[str], object] = sys.stdout.write) -> int:
    """Gather the rows and write the results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--rows", type=Path, default=Path("runs") / "hidden_effects", help="folder of CSV files"
    )
    parser.add_argument("--out", type=Path, default=Path("results") / "diagnose" / "hidden_effects")
    args = parser.parse_args(arguments)
    try:
        rows = gather(args.rows)
    except ResumeError as error:
        sys.stderr.write(f"hidden_results: {error}\n")
        return 2
    if not rows:
        sys.stderr.write(f"hidden_results: {args.rows} has no rows of a study of hidden effects\n")
        return 2
    write_results(rows, args.out)
    write("\n".join(table(rows)) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
