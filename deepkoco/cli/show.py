"""`deepkoco show`: summarise a recording of a graph, show a graph to be edited, or analyse a trained model."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from deepkoco.cli.input_error import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from deepkoco.graph.episodes.storage.read import RecordedRun
    from deepkoco.graph.episodes.storage.summary import RunSummary, Spread

DESCRIPTION = """\
For a recording of a graph (MCAP): show its nodes with nominal and realised rates, its delays (mean, median, 99 %
quantile), overruns and losses. Options draw it or write an interactive page. For a Python file with a function graph():
show rates, delays and windows; the page lets you edit them, and the parameters, and saves YAML that --setup reads. For
a training run or an exported model (a folder): analyse the latent model on new episodes and write one page (about a
minute)."""
EXAMPLE = """\
example:
  deepkoco show runs/rod.mcap
  deepkoco show runs/rod.mcap --pictures runs/rod_pictures --html runs/rod.html
  deepkoco show runs/rod.mcap.partial --partial      the complete part of a killed run
  deepkoco show robot.py --html robot.html           a graph, to be edited
  deepkoco show robot.py --setup setup.yaml          the same with what was saved
  deepkoco show runs/first --out first.html          analysis of a trained model
  deepkoco show model --task Pendulum-v1             a model without the name of its task"""
OF_A_RECORDING = ("partial", "episode", "start", "stop", "pictures", "html")
NOT_OF_A_GRAPH = ("partial", "episode", "start", "stop")
OF_A_GRAPH = ("setup",)
OF_A_RUN = ("out", "task", "reference", "axes", "seed")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco show`."""
    parser.add_argument(
        "path",
        type=Path,
        metavar="RECORDING|GRAPH.py|RUN",
        help="recording, .mcap, file with a function graph(), or folder of a training run or model",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")
    recording = parser.add_argument_group("options of a recording or a graph")
    recording.add_argument(
        "--partial", action="store_true", help="read the complete part of a truncated file"
    )
    recording.add_argument(
        "--episode", type=int, default=0, metavar="N", help="episode that is drawn (first: 0)"
    )
    recording.add_argument("--from", dest="start", type=float, metavar="S", help="start of the timeline [s]")
    recording.add_argument("--to", dest="stop", type=float, metavar="S", help="end of the timeline [s]")
    recording.add_argument(
        "--pictures", type=Path, metavar="DIR", help="new folder for graph, timeline, delays"
    )
    recording.add_argument("--html", type=Path, metavar="PAGE.html", help="interactive page to write")
    recording.add_argument(
        "--setup", type=Path, metavar="SETUP.yaml",
        help="rates, delays, windows and parameters in the place of those of GRAPH.py",
    )  # fmt: skip
    trained = parser.add_argument_group("options of a training run or model")
    trained.add_argument(
        "--out", type=Path, metavar="PAGE.html", help="page to write (default: analysis.html in the folder)"
    )
    trained.add_argument("--task", metavar="ID", help="Gymnasium id of the task, for a model without it")
    trained.add_argument(
        "--reference", type=Path, metavar="CSV",
        help="costs to compare with, columns name, mean and, where known, standard_error, episodes",
    )  # fmt: skip
    trained.add_argument(
        "--axes", type=int, nargs=2, metavar=("I", "J"),
        help="two inputs, counted from 0, for maps of a task without a plane (default: the most important two)",
    )  # fmt: skip
    trained.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of the start states (default: 0)"
    )
    parser.set_defaults(parser=parser)


def run(args: argparse.Namespace) -> int:
    """Show a recording or a graph, or analyse a run.

    Raises:
        InputError: It is none of them, or an option belongs to another one.
    """
    if args.path.is_dir():
        _refuse(
            args, OF_A_RECORDING + OF_A_GRAPH, "recordings and graphs", "folder of a training run or model"
        )
        from deepkoco.cli.show_run import show_run

        if args.seed < 0:
            raise InputError(f"--seed {args.seed}: give 0 or more")
        return show_run(args)
    if not args.path.exists():
        raise InputError(
            f"{args.path}: no such file or folder; give a recording (.mcap), a file with a graph (.py), or the "
            "folder of a training run or model"
        )
    if args.path.suffix == ".py":
        _refuse(args, NOT_OF_A_GRAPH, "recordings", "file of a graph")
        _refuse(args, OF_A_RUN, "training runs and models", "file of a graph")
        from deepkoco.cli.show_graph import show_graph

        return show_graph(args)
    _refuse(args, OF_A_GRAPH, "files of a graph", "recording")
    _refuse(args, OF_A_RUN, "training runs and models", "recording")
    return show_recording(args)


def _refuse(args: argparse.Namespace, names: tuple[str, ...], whose: str, given: str) -> None:
    """Refuse options of the other kind instead of ignoring them."""
    spelled = {"start": "from", "stop": "to"}
    wrong = [f"--{spelled.get(n, n)}" for n in names if getattr(args, n) != args.parser.get_default(n)]
    if wrong:
        verb = "belongs" if len(wrong) == 1 else "belong"
        raise InputError(f"{args.path}: {', '.join(wrong)} {verb} to {whose}, but this is the {given}")


def show_recording(args: argparse.Namespace) -> int:
    """Print the summary of a recording, and draw it if requested.

    Raises:
        InputError: The recording cannot be used, or an output exists.
    """
    from deepkoco.graph.drawing.style import DrawingError
    from deepkoco.graph.episodes.storage.container import EpisodeFileError
    from deepkoco.graph.episodes.storage.read import read_episodes
    from deepkoco.graph.episodes.storage.summary import summarise_run

    for target in (args.pictures, args.html):
        if target is not None and target.exists():
            raise InputError(f"{target}: exists; choose another name or move it away")
    try:
        recorded = read_episodes(args.path, partial=args.partial)
        summary = summarise_run(recorded)
        if args.pictures is not None or args.html is not None:
            _draw(args, recorded)
    except (EpisodeFileError, DrawingError) as error:
        raise InputError(str(error)) from error
    if args.json:
        content = {"path": str(args.path), "complete": recorded.complete, "failures": recorded.failures}
        content |= {"meta": recorded.meta}
        sys.stdout.write(json.dumps(content | asdict(summary), indent=2) + "\n")
        return 0
    from rich.console import Console

    console = Console()
    for table in tables(recorded, summary):
        console.print(table)
    for number, episode in enumerate(recorded.episodes):
        for note in episode.notes:
            where = f"episode {number}, {note.t:.3f} s" + (f", {note.node}" if note.node else "")
            console.print(f"{note.level} ({where}): {note.text}", highlight=False, markup=False)
        if episode.failure and all(note.text != episode.failure for note in episode.notes):
            console.print(f"failed (episode {number}): {episode.failure}", highlight=False, markup=False)
    if recorded.meta:
        facts = ", ".join(f"{key}: {value}" for key, value in recorded.meta.items())
        console.print(facts, highlight=False, markup=False)
    return 0


def _draw(args: argparse.Namespace, recorded: RecordedRun) -> None:
    from deepkoco.graph.drawing import (
        DrawingError,
        draw_delays,
        draw_graph,
        draw_signals,
        draw_timeline,
        write_page,
    )
    from deepkoco.output.new_folder import new_folder
    from deepkoco.output.whole_file import writing

    if not 0 <= args.episode < len(recorded.episodes):
        raise InputError(f"{args.path}: there is no episode {args.episode}; it has {len(recorded.episodes)}")
    graph, episode = recorded.graph, recorded.episodes[args.episode]
    if args.pictures is not None:
        pictures = [draw_graph(graph), draw_timeline(graph, episode, args.start, args.stop)]
        with contextlib.suppress(DrawingError):  # no delay is above 0
            pictures.append(draw_delays(graph, recorded.episodes))
        with contextlib.suppress(DrawingError):  # no output is a few numbers
            pictures.append(draw_signals(graph, episode, args.start, args.stop))
        with new_folder(args.pictures) as folder:
            for picture in pictures:
                picture.save(folder)
    if args.html is not None:
        with writing(args.html):
            args.html.parent.mkdir(parents=True, exist_ok=True)
        write_page(args.html, graph, episode, args.path.name)


def tables(recorded: RecordedRun, summary: RunSummary) -> tuple[Table, Table]:
    """Nodes and connections of a recording as tables for the terminal."""
    from rich.table import Table
    from rich.text import Text

    number = f"{summary.episodes} episode{'s' * (summary.episodes != 1)}"
    cut = "" if recorded.complete else " · failed" if recorded.failures else " · cut off"
    nodes, connections = (
        Table(title=Text(title), title_justify="left", box=None, padding=(0, 1, 0, 0))
        for title in (f"{recorded.path} · {number} · {summary.seconds:.2f} s{cut}", "")
    )
    spread = ("mean\nms", "p50\nms", "p99\nms")
    nodes.add_column("node")
    for heading in ("steps", "rate\nHz", "realised\nHz", *spread, "overruns", "late"):
        nodes.add_column(heading, justify="right", no_wrap=True)
    for n in summary.nodes:
        nodes.add_row(
            Text(n.name),
            str(n.steps),
            f"{n.rate_hz:g}",
            "-" if n.realised_hz is None else f"{n.realised_hz:.2f}",
            *_milliseconds(n.computation),
            str(n.overruns),
            str(n.late),
        )
    connections.add_column("connection")
    for heading in ("messages", "lost", *spread):
        connections.add_column(heading, justify="right", no_wrap=True)
    for c in summary.connections:
        connections.add_row(Text(c.key), str(c.messages), str(c.lost), *_milliseconds(c.communication))
    return nodes, connections


def _milliseconds(spread: Spread) -> list[str]:
    values = (spread.mean_s, spread.p50_s, spread.p99_s)
    return ["-" if value is None else f"{1000 * value:.2f}" for value in values]
