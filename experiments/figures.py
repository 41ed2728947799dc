"""Learning curves of several agents: `python -m experiments.figures RUNS... --figure 5.2 --out results/figures/...`.

Takes folders of training runs, also of runs that are kept without their weights, and writes the figure, the CSV it
draws, every evaluation of every seed, tables of final costs and of sample efficiency, and a page.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from deepkoco.output.new_folder import new_folder
from deepkoco.runs.hydra_command import BAD_INPUT
from deepkoco.runs.settings import ExperimentError
from experiments.comparison.curves import learning_curves
from experiments.comparison.drawing import draw, panel_title
from experiments.comparison.efficiency import sample_efficiency, times_to_target
from experiments.comparison.page import final_markdown, page
from experiments.comparison.references import REFERENCES, References, load_references
from experiments.comparison.runs import ComparedRun, evaluations, find_runs, settings_table
from experiments.comparison.tables import final_costs
from experiments.provenance import as_markdown


@dataclass(frozen=True)
class Figure:
    """One of the thesis' figures.

    Attributes:
        title: Of its page.
        observation: What the agents see.
        tasks: Its tasks, by name.
        distractors: Of its panels.
    """

    title: str
    observation: str
    tasks: tuple[str, ...]
    distractors: tuple[str, ...] = ("none", "copies")

    @property
    def panels(self) -> list[tuple[str, str, str]]:
        """Task, observation and distractors of each."""
        return [(task, self.observation, d) for task in self.tasks for d in self.distractors]


FIGURES = {
    "5.2": Figure("Figure 5.2: learning from states", "states", ("pendulum", "manipulator")),
    "5.3": Figure("Figure 5.3: learning from images", "images", ("pendulum",)),
}


def choose(runs: Sequence[ComparedRun], figure: Figure) -> list[ComparedRun]:
    """The runs that a figure shows.

    Args:
        runs: All that were found.
        figure: Which figure.

    Raises:
        ExperimentError: None of the runs belongs to it.
    """
    wanted = figure.tasks
    chosen = [r for r in runs if r.config.observation == figure.observation and r.config.task.name in wanted]
    if not chosen:
        found = sorted({panel_title(*run.panel) for run in runs})
        raise ExperimentError(
            f"no run of {', '.join(wanted)} from {figure.observation}; there are runs of: {'; '.join(found)}"
        )
    return chosen


def references_of(
    runs: Sequence[ComparedRun], tasks: Sequence[str], folder: Path
) -> dict[str, References | None]:
    """The references of the tasks of some runs.

    Args:
        runs: Of these tasks.
        tasks: Names, in their order.
        folder: Of `experiments.reference_costs`.

    Returns:
        By task; None where nothing is known, or its runs do not all have the task that is known.
    """
    known: dict[str, References | None] = {}
    for name in tasks:
        kinds = [run.config.task for run in runs if run.config.task.name == name]
        different = [task for k, task in enumerate(kinds) if task not in kinds[:k]]
        if different:
            known[name] = load_references(different[0], folder) if len(different) == 1 else None
    return known


def write_figure(
    runs: Sequence[ComparedRun],
    figure: Figure,
    factors: Sequence[float],
    references: Path,
    out: Path,
    command: str,
) -> pd.DataFrame:
    """Write everything into a new folder, all or nothing.

    Args:
        runs: Those to show.
        figure: Which figure.
        factors: Multiples of the optimum for the table of sample efficiency.
        references: Folder of `experiments.reference_costs`.
        out: Folder to make.
        command: That the page names.

    Returns:
        The table of final costs.

    Raises:
        ExperimentError: The folder exists, or the runs cannot be compared.
    """
    if out.exists():
        raise ExperimentError(f"{out}: exists already; choose another --out")
    table = evaluations(runs)
    known = references_of(runs, figure.tasks, references)
    curves, final = learning_curves(table), final_costs(table, known)
    times = times_to_target(table, known, factors)
    efficiency = sample_efficiency(times)
    there = {run.panel for run in runs}
    missing = [panel_title(*panel) for panel in figure.panels if panel not in there]
    with new_folder(out) as partial:
        tables = {"curves": curves, "raw": table, "final": final, "times": times, "efficiency": efficiency}
        tables["settings"] = settings_table(runs)
        for name, content in tables.items():
            content.to_csv(partial / f"{name}.csv", index=False, float_format="%.6g")
        draw(curves, known, partial / "learning_curves.png")
        text = page(figure.title, command, Path("learning_curves.png"), final, efficiency, known, missing)
        (partial / "README.md").write_text(text, encoding="utf-8")
        (partial / "PROVENANCE.md").write_text(as_markdown() + "\n", encoding="utf-8")
    return final


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        description="Learning curves, final costs and sample efficiency of agents."
    )
    parser.add_argument(
        "runs", type=Path, nargs="+", metavar="RUNS", help="folders that hold runs, at any depth"
    )
    parser.add_argument("--figure", choices=FIGURES, required=True, help="5.2 from states, 5.3 from images")
    parser.add_argument("--out", type=Path, required=True, help="new folder")
    parser.add_argument(
        "--tasks", nargs="+", default=[], metavar="TASK", help="in the place of the figure's own"
    )
    parser.add_argument(
        "--targets",
        type=float,
        nargs="+",
        default=[1.25],
        metavar="X",
        help="multiples of the optimum (default 1.25)",
    )
    parser.add_argument(
        "--unfinished", action="store_true", help="show runs that are not finished too, marked as such"
    )
    parser.add_argument(
        "--references",
        type=Path,
        default=REFERENCES,
        help="folder of experiments.reference_costs (default: the stored)",
    )
    args = parser.parse_args(arguments)
    try:
        if not min(args.targets) >= 1:
            raise ExperimentError(
                f"--targets {min(args.targets):g}: give multiples of the optimum, of at least 1"
            )
        figure = FIGURES[args.figure]
        if args.tasks:
            figure = replace(figure, tasks=tuple(args.tasks))
        runs = choose(find_runs(args.runs, args.unfinished), figure)
        given = [
            Path(a).name if Path(a).is_absolute() else a
            for a in (sys.argv[1:] if arguments is None else arguments)
        ]
        command = shlex.join(["python", "-m", "experiments.figures", *given])
        final = write_figure(runs, figure, args.targets, args.references, args.out, command)
    except BAD_INPUT as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(final_markdown(final))
    print(f"written to {args.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
