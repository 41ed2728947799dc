"""The page that goes with a figure: what it shows, where it comes from, and the tables in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from experiments.comparison.drawing import method_label, panel_title
from experiments.comparison.references import References
from experiments.comparison.runs import PANEL
from experiments.comparison.style import method_rank


def _rows(table: pd.DataFrame) -> list[dict]:
    """Rows of each task together, the clean ones first."""
    rows = table.to_dict("records")
    return sorted(
        rows,
        key=lambda r: (r["task"], r["distractors"] != "none", r["distractors"], *method_rank(r["agent"])),
    )


def _title(row: Mapping) -> str:
    return panel_title(*(row[name] for name in PANEL))


def _number(value: float) -> str:
    if math.isnan(value):
        return ""
    return "never" if math.isinf(value) else f"{value:.3g}" if abs(value) < 100 else f"{value:,.0f}"


def _interval(low: float, high: float) -> str:
    return "" if math.isnan(low) else f"{_number(low)} to {_number(high)}"


def final_markdown(final: pd.DataFrame) -> str:
    """Table of final costs and of the training behind them."""
    lines = [
        "| task | method | seeds | cost, iqm | 95 % | best to worst | of the optimum | episodes | steps | updates | "
        "seconds a seed |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in _rows(final):
        seeds = f"{row['n']}" + (f", {row['unfinished']} unfinished" if row["unfinished"] else "")
        cells = [
            _title(row),
            method_label(row["agent"], row["variant"]),
            seeds,
            _number(row["iqm"]),
            _interval(row["low"], row["high"]),
            _interval(row["best"], row["worst"]),
            "" if math.isnan(row["optimum"]) else f"{row['iqm'] / row['optimum']:.2f} x",
            *(f"{row[name]:,.0f}" for name in ("episodes", "steps", "updates", "seconds")),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def efficiency_markdown(efficiency: pd.DataFrame) -> str:
    """Table of the episodes and steps to multiples of the optimum."""
    lines = [
        "| task | method | target | criterion | seeds that arrive | episodes, median | 95 % | steps, median | 95 % |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in _rows(efficiency):
        marked = f", {row['unfinished']} unfinished" if row["unfinished"] else ""
        cells = [
            _title(row),
            method_label(row["agent"], row["variant"]),
            f"{row['factor']:g} x optimum",
            row["criterion"],
            f"{row['arrived']} of {row['seeds']}{marked}",
            _number(row["episodes"]),
            _interval(row["episodes_low"], row["episodes_high"]),
            _number(row["steps"]),
            _interval(row["steps_low"], row["steps_high"]),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def steps_text(final: pd.DataFrame) -> str:
    """How much training each method had, one sentence per panel."""
    sentences = []
    for title in dict.fromkeys(_title(row) for row in _rows(final)):
        own = [row for row in _rows(final) if _title(row) == title]
        parts = ", ".join(
            f"{method_label(row['agent'], row['variant'])} {row['steps']:,} steps ({row['episodes']:,} episodes, "
            f"{row['updates']:,} updates)"
            for row in own
        )
        sentences.append(f"- {title}: {parts}.")
    return "\n".join(sentences)


def references_text(references: Mapping[str, References | None]) -> str:
    """Where the horizontal lines come from."""
    lines = []
    for task, known in references.items():
        if known is None:
            lines.append(f"- {task}: no optimum is stored for these settings (experiments.reference_costs).")
        else:
            lines.append(
                f"- {task}: optimum {known.optimum:.1f} with one step of input delay, as DeepKoCo has it "
                f"({known.optimum_without_delay:.1f} without, as the others act), random policy {known.random:.0f}; "
                f"means over {known.episodes} start states."
            )
    return "\n".join(lines)


def page(
    title: str,
    command: str,
    image: Path,
    final: pd.DataFrame,
    efficiency: pd.DataFrame,
    references: Mapping[str, References | None],
    missing: Sequence[str],
) -> str:
    """The whole page.

    Args:
        title: First line.
        command: That made it.
        image: The figure.
        final: As given by `tables.final_costs`.
        efficiency: As given by `efficiency.sample_efficiency`; may be empty.
        references: By task.
        missing: Panels that the figure should have and there are no runs for.

    Returns:
        Markdown.
    """
    parts = [f"# {title}", f"```\n{command}\n```", f"![learning curves]({image.name})"]
    if missing:
        parts.append("No runs were given for: " + "; ".join(missing) + ".")
    if final["unfinished"].to_numpy().any():
        parts.append(
            "**Some runs are not finished.** They are counted in the legends and tables; their last cost is of few "
            "episodes, and one that has not come to a target counts as never."
        )
    parts += [
        "Noise-free cost of an episode. Lines: interquartile mean over seeds, at equal environment steps, "
        "interpolated, for the methods evaluate at different times; bands: 95 % percentile bootstrap over seeds, "
        "which of fewer than 5 seeds is the range of their costs. The "
        "other axes are medians over seeds of what they had after so many steps. A curve starts at the first "
        "evaluation. Seconds are of the machine as it was, evaluations included. During training a cost is of the "
        "few episodes in `raw.csv`, at the end of a finished run of more, from other start states.",
        "How much training each method had (the least of its seeds):",
        steps_text(final),
        "Horizontal lines:",
        references_text(references),
        "## Final cost",
        final_markdown(final),
    ]
    if not efficiency.empty:
        parts += [
            "## Sample efficiency",
            "Episodes and environment steps to a multiple of the optimum: `reached` at the first evaluation at or "
            "below it, `kept` from the evaluation on from which all are; neither can be before the first evaluation. "
            "Every evaluation is held against the optimum "
            "of its own start states where that is stored. Median over seeds with its 95 % bootstrap interval; "
            '"never" stands for a median or limit that lies among seeds that do not arrive.',
            efficiency_markdown(efficiency),
        ]
    parts.append(
        "`curves.csv` is what the figure draws, `raw.csv` every evaluation of every seed, `final.csv` and "
        "`efficiency.csv` the tables, `times.csv` the episodes and steps of every seed, `settings.csv` every "
        "hyper-parameter of every method."
    )
    return "\n\n".join(parts) + "\n"
