"""`deepkoco show RUN`: analyse a trained latent model and write one page."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from deepkoco.cli.input_error import InputError


def show_run(args: argparse.Namespace) -> int:
    """Analyse a run and write the page.

    Args:
        args: Arguments path, out, task, reference, axes, seed and json.

    Returns:
        0.

    Raises:
        InputError: The run cannot be used, or the page exists.
    """
    from deepkoco.agent.checkpoint import CheckpointError
    from deepkoco.agent.collection import SpaceError
    from deepkoco.analysis.measures.collect import ModelMismatchError
    from deepkoco.analysis.measures.comparison import ReferenceCostError, read_reference
    from deepkoco.analysis.measures.modes import ModesError
    from deepkoco.analysis.page.analyse import AnalysisOptions, analyse
    from deepkoco.analysis.page.page import PageExistsError, check_free, data_folder, write_page
    from deepkoco.analysis.run_folder import RunFolderError, read_trained
    from deepkoco.envs.film import FilmError
    from deepkoco.envs.task_factory import TaskError

    out: Path = args.out or args.path / "analysis.html"
    if out.suffix != ".html":
        raise InputError(f"--out {out}: give a name that ends in .html")
    known = (
        RunFolderError, ReferenceCostError, PageExistsError, TaskError, SpaceError, ModelMismatchError,
        ModesError, FilmError, CheckpointError,
    )  # fmt: skip
    try:
        check_free(out)
        reference = {} if args.reference is None else read_reference(args.reference)
        run = read_trained(args.path, args.task)
        axes = None if args.axes is None else (args.axes[0], args.axes[1])
        if axes is not None and not all(0 <= i < run.model.observation_size for i in axes):
            raise InputError(f"--axes {axes[0]} {axes[1]}: inputs are 0 to {run.model.observation_size - 1}")
        images = run.settings.observation == "images"
        fewer = {"exploring_episodes": 40, "prunings": 3, "film_plans": 50} if images else {}
        options = AnalysisOptions(axes=axes, seed=args.seed, **fewer)
        columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
        console = Console(stderr=True)
        with Progress(*columns, console=console, disable=not sys.stderr.isatty()) as bar:
            task = bar.add_task("", total=1)

            def report(text: str, done: int, stages: int) -> None:
                bar.update(task, description=text, completed=done, total=stages)

            page = analyse(run, options, reference, report)
            write_page(page, out)
            bar.update(task, completed=bar.tasks[0].total)
    except known as error:
        raise InputError(str(error)) from error
    if args.json:
        numbers = [{"value": value, "text": text} for value, text in page.tiles]
        result = {
            "page": str(out),
            "data": str(data_folder(out)),
            "numbers": numbers,
            "left_out": list(page.notes),
        }
        sys.stdout.write(json.dumps(result, indent=2) + "\n")
        return 0
    for value, text in page.tiles:
        sys.stdout.write(f"{value}: {text}\n")
    for note in page.notes:
        sys.stdout.write(f"left out: {note}\n")
    sys.stdout.write(f"{out} and its data in {data_folder(out)}\n")
    return 0
