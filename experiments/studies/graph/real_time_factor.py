"""Realised real-time factor with and without a delay on a connection (thesis Fig. 2.7).

    python -m experiments.studies.graph.real_time_factor --out results/graph/real_time_factor

A world and a camera, each in a process of its own, both compute for a while at every tick. Without a delay
the camera needs the world's message of the same tick, so they compute one after the other; with a delay it
needs an earlier one, so they compute at the same time.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from deepkoco.graph import Connection, Graph, Supervisor
from deepkoco.graph.live import ConcurrentRuntime
from experiments.studies.graph.live_study import Relay, load, run_study

# Tables and figures are imported where they are made: the processes of the nodes import this module, too.
if TYPE_CHECKING:
    import pandas as pd

    from deepkoco.graph.drawing.style import Picture

RATE = 20  # [Hz]
DELAYS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of a period


def pipeline(work: float, delay: float, spin: bool) -> Graph:
    """World to camera to agent to world, all at the same rate.

    Args:
        work: computation of world and camera [s].
        delay: on the way from the world to the camera [s].
        spin: whether they keep a core busy.
    """
    action = torch.zeros(2, dtype=torch.float64)
    return Graph(
        [
            Relay("world", RATE, work, spin),
            Relay("camera", RATE, work, spin),
            Supervisor("agent", RATE, initial_action=action),
        ],
        [
            Connection("agent", "world", skip=True),
            Connection("world", "camera", delay=delay),
            Connection("camera", "agent"),
        ],
    )


def reached_factor(graph: Graph, steps: int) -> float:
    """Run as fast as it goes; return simulated time by real time, without the first steps."""
    warm_up = max(3, steps // 10)
    action = torch.zeros(1, 2, dtype=torch.float64)
    with ConcurrentRuntime(graph, processes={"world": 1, "camera": 2}, record=False) as runtime:
        runtime.reset({}, torch.Generator())
        runtime.run(lambda _: action, warm_up)
        begin = time.monotonic()
        runtime.run(lambda _: action, steps)
        return steps / RATE / (time.monotonic() - begin)


def study(arguments: argparse.Namespace) -> tuple[list[Picture], str]:
    """Measure all cases, the repetitions in turn."""
    import pandas as pd

    rows = [
        {
            "computation_ms": work,
            "delay_periods": delay,
            "repetition": repetition,
            "real_time_factor": reached_factor(
                pipeline(work / 1e3, delay / RATE, arguments.work == "spin"), arguments.steps
            ),
            "one_after_the_other": 1e3 / RATE / (2 * work),
            "at_the_same_time": 1e3 / RATE / work,
            "work": arguments.work,
            "load_average": load(),
        }
        for repetition in range(arguments.repetitions)
        for work in arguments.computation
        for delay in DELAYS
    ]
    table = pd.DataFrame(rows)
    return [draw(table)], report(table, arguments)


def draw(table: pd.DataFrame) -> Picture:
    """Reached factor against the delay, one line for each length of the computation."""
    from matplotlib.figure import Figure

    from deepkoco.graph.drawing.style import PALETTE, Picture, figure_style

    with figure_style():
        figure = Figure(figsize=(7, 4))
        axes = figure.subplots()
        for colour, (work, group) in zip(PALETTE, table.groupby("computation_ms"), strict=False):
            values = group.groupby("delay_periods").real_time_factor.agg(["median", "min", "max"])
            axes.plot(values.index, values["median"], "o-", ms=4, color=colour, label=f"{work:g} ms")
            axes.fill_between(values.index, values["min"], values["max"], color=colour, alpha=0.2, lw=0)
            for bound, style in (("one_after_the_other", ":"), ("at_the_same_time", "--")):
                axes.axhline(group[bound].iloc[0], color=colour, ls=style, lw=1)
        axes.plot([], [], ":", color="#222222", lw=1, label="one after the other")
        axes.plot([], [], "--", color="#222222", lw=1, label="at the same time")
        axes.set(
            xlabel="delay from world to camera [periods]", ylabel="real-time factor reached", yscale="log"
        )
        axes.legend(title="computation a tick", fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return Picture("real_time_factor", figure, table)


def report(table: pd.DataFrame, arguments: argparse.Namespace) -> str:
    """The README of the study."""
    lines = []
    for work, group in table.groupby("computation_ms"):
        median = group.groupby("delay_periods").real_time_factor.median()
        gain = median[1.0] / median[0.0]
        lines.append(
            f"| {work:g} | {median[0.0]:.2f} | {group.one_after_the_other.iloc[0]:.2f} | {median[1.0]:.2f} "
            f"| {group.at_the_same_time.iloc[0]:.2f} | {gain:.2f} |"
        )
    rows = "\n".join(lines)
    steps = arguments.steps
    work = "keep a core busy" if arguments.work == "spin" else "sleep, as if they waited for a device"
    options = f"--work {arguments.work} --steps {steps} --repetitions {arguments.repetitions}"
    return f"""# Realised real-time factor with and without a delay

`python -m experiments.studies.graph.real_time_factor {options}`

World, camera and agent form a loop at {RATE} Hz, world and camera in processes of their own, synchronised by message
counts, as fast as it goes. World and camera compute at each tick: they {work}.
Without a delay between them the camera waits for the world at every tick; with one it works on an earlier message,
and they overlap.

| computation [ms] | no delay | bound: one after the other | delay of a period | bound: at the same time | gain |
|---|---|---|---|---|---|
{rows}

![real-time factor](real_time_factor.png)"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; return the exit status."""
    assert __doc__
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/graph/real_time_factor"))
    parser.add_argument(
        "--computation", type=float, nargs="+", default=[5.0, 10.0, 20.0], help="a step takes [ms]"
    )
    parser.add_argument("--work", choices=("sleep", "spin"), default="sleep")
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--repetitions", type=int, default=3)
    return run_study(argv, parser, study)


if __name__ == "__main__":
    sys.exit(main())
