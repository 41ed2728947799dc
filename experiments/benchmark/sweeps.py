"""Trains what a suite lacks, by the sweeps of `deepkoco sweep`, and shows how far it is."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from deepkoco.output.whole_file import writing
from deepkoco.runs.train import is_finished, load_run_config
from experiments.benchmark.suite import Cell, Suite, cells

LOG = "sweeps.log"
POLL = 1.0  # seconds between two looks at the folders
KEPT_LINES = 12  # of the log, where a sweep fails

Tell = Callable[[float, str], None]
"""Called with the finished share of all runs, in runs, and what goes on."""


def sweep_commands(
    suite: Suite, out: Path, launcher: str | None
) -> Iterator[tuple[str, list[str], list[Cell]]]:
    """The sweeps that train a suite: one for each seed, distractors and agent.

    A launcher that runs many at once gets all seeds in one sweep, or most of its processes would have nothing to do.

    Args:
        suite: What to train.
        out: Folder of the benchmark.
        launcher: hydra/launcher, or none.

    Yields:
        What it trains in words, the arguments of Python, and its runs.
    """
    tasks = ",".join(suite.tasks)
    for seeds in [[seed] for seed in suite.seeds] if launcher is None else [suite.seeds]:
        for among in suite.among:
            for agent, own in suite.agents.items():
                folder = f"{out.resolve()}/runs/{agent}/${{task.name}}/{among}/seed_${{seed}}"
                given = [f"seed={','.join(map(str, seeds))}", f"task={tasks}", f"+among={among}", *own]
                given += [*suite.settings, "existing=resume", f"run='{folder}'"]
                given += [] if launcher is None else [f"hydra/launcher={launcher}"]
                chosen = [c for c in cells(suite) if (c.agent, c.among) == (agent, among) and c.seed in seeds]
                yield f"{agent}, {among}", ["-m", "deepkoco.cli", "sweep", *given], chosen


def share(folder: Path) -> float:
    """How much of a run is done, 0 to 1, by its training episodes."""
    if is_finished(folder):
        return 1.0
    try:
        text = (folder / "metrics.csv").read_text(encoding="utf-8")
        lines = text.splitlines()
        done = float(lines[-1].split(",")[lines[0].split(",").index("episodes")])
        return min(0.99, done / load_run_config(folder).agent.total_episodes)
    except (OSError, ValueError, IndexError):
        return 0.0


def train_all(suite: Suite, out: Path, launcher: str | None, tell: Tell) -> list[str]:
    """Bring all runs of a suite to their end, as far as that is not done.

    A run that fails does not stop the others.

    Args:
        suite: What to train.
        out: Folder of the benchmark; made if it is not there.
        launcher: hydra/launcher, or none.
        tell: Told how far it is.

    Returns:
        What went wrong, one text for each sweep that did not come to its end.
    """
    every, failed = [cell.folder(out) for cell in cells(suite)], []
    shares = dict.fromkeys(every, 0.0)

    def look(what: str) -> None:
        shares.update({folder: share(folder) for folder, done in shares.items() if done < 1.0})
        tell(sum(shares.values()), what)

    look("looking at what is there")
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    for what, arguments, chosen in sweep_commands(suite, out, launcher):
        if all(is_finished(cell.folder(out)) for cell in chosen):
            continue
        with (out / LOG).open("ab") as log:
            begun = log.tell()
            environment = {**os.environ, "OMP_NUM_THREADS": "1"}
            process = subprocess.Popen(
                [sys.executable, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
            )
            try:
                while process.poll() is None:
                    look(what)
                    time.sleep(POLL)
            finally:
                if process.poll() is None:  # stopped by hand; what it wrote is gone on with next time
                    process.terminate()
                    process.wait()
        if process.returncode:
            said = (out / LOG).read_bytes()[begun:].decode(errors="replace").strip().splitlines()
            failed.append("\n".join([f"{what}: status {process.returncode}", *said[-KEPT_LINES:]]))
        look(what)
    return failed


class Display:
    """A bar over all runs on a terminal, and a line for each finished run elsewhere.

    Args:
        runs: How many there are.
    """

    def __init__(self, runs: int) -> None:
        self._console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self._bar = Progress(*columns, console=self._console, disable=not self._console.is_terminal)
        self._task = self._bar.add_task("", total=runs)
        self._runs, self._told = runs, -1

    def __enter__(self) -> Display:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def tell(self, done: float, what: str) -> None:
        """Show how many runs are done, the parts of unfinished ones counted too."""
        self._bar.update(self._task, completed=round(done, 1), description=what)
        if not self._console.is_terminal and int(done) != self._told:
            self._told = int(done)
            print(f"{self._told} of {self._runs} runs; {what}", file=sys.stderr, flush=True)


def unfinished(suite: Suite, out: Path) -> Sequence[Cell]:
    """Runs that have not come to their end."""
    return [cell for cell in cells(suite) if not is_finished(cell.folder(out))]
