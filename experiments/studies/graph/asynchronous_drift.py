"""Drift of asynchronous runs from the synchronised one against the real-time factor (thesis Fig. 2.7a).

    python -m experiments.studies.graph.asynchronous_drift --out results/graph/asynchronous_drift

A pendulum, its sensor and an open-loop agent run in processes of their own, at several real-time factors,
synchronised by message counts and not. The commands are the same in every run, so what differs is timing alone.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph import Graph, Input
from deepkoco.graph.live import ConcurrentRuntime, SimulatedRuntime
from experiments.studies.graph.live_study import load, pendulum_loop, run_study

# Tables and figures are imported where they are made: the processes of the nodes import this module, too.
if TYPE_CHECKING:
    import pandas as pd

    from deepkoco.graph.drawing.style import Picture

PROCESSES = {"world": 1, "sensor": 2}


class Swing:
    """Open-loop commands: a sum of two sines that moves the pendulum about its hanging rest [N m].

    Args:
        rate: commands per second [Hz].
    """

    def __init__(self, rate: float) -> None:
        self.rate, self.step = rate, 0

    def __call__(self, inputs: dict[str, Input]) -> Tensor:
        t = self.step / self.rate
        self.step += 1
        torque = 0.8 * math.sin(2.0 * t) + 0.6 * math.sin(4.3 * t)
        return torch.tensor([[torque]], dtype=torch.float64)


class Run(NamedTuple):
    """What the agent saw at its steps, (steps + 1, 2) [rad, rad/s], and the real-time factor that was reached."""

    seen: np.ndarray
    reached: float


def run(runtime: ConcurrentRuntime | SimulatedRuntime, graph: Graph, steps: int) -> Run:
    """Run one episode.

    Args:
        runtime: not started yet.
        graph: what it runs.
        steps: of the agent.
    """
    rate = float(graph.node("agent").rate)
    swing = Swing(rate)
    seen = []
    with runtime:
        state, inputs = runtime.reset({}, torch.Generator().manual_seed(0))
        begin = time.monotonic()
        for _ in range(steps):
            seen.append(inputs["sensor"].data[0, -1].numpy())
            state, inputs = runtime.step(state, swing(inputs))  # type: ignore[arg-type]
        reached = steps / rate / (time.monotonic() - begin)
    seen.append(inputs["sensor"].data[0, -1].numpy())
    return Run(np.stack(seen), reached)


def study(arguments: argparse.Namespace) -> tuple[list[Picture], str]:
    """Run all factors, the repetitions in turn so that a busy minute hits all of them."""
    import pandas as pd

    graph = pendulum_loop(100, 50, 20, 0.02)
    steps = round(arguments.seconds * 20)
    reference = run(SimulatedRuntime(graph), graph, steps).seen
    rows = []
    for repetition in range(arguments.repetitions):
        for factor in arguments.factors:
            for sync in (True, False):
                runtime = ConcurrentRuntime(
                    graph, processes=PROCESSES, real_time_factor=factor, sync=sync, seed=repetition
                )
                done = run(runtime, graph, steps)
                error = (done.seen - reference)[:, 0]
                rows.append(
                    {
                        "real_time_factor": factor,
                        "synchronised": sync,
                        "repetition": repetition,
                        "reached_real_time_factor": done.reached,
                        "rms_drift_rad": float(np.sqrt(np.mean(error**2))),
                        "largest_drift_rad": float(np.abs(error).max()),
                        "load_average": load(),
                    }
                )
    table = pd.DataFrame(rows)
    if (table[table.synchronised].largest_drift_rad != 0).any():
        raise AssertionError("a synchronised run differs from the single-process one")
    return [draw(table)], report(table, arguments)


def draw(table: pd.DataFrame) -> Picture:
    """Drift and reached factor against the demanded one: median and range of the repetitions."""
    from matplotlib.figure import Figure

    from deepkoco.graph.drawing.style import PALETTE, Picture, figure_style

    with figure_style():
        figure = Figure(figsize=(8, 3.4))
        left, right = figure.subplots(1, 2)
        for sync, colour, label in (
            (True, PALETTE[2], "synchronised"),
            (False, PALETTE[1], "asynchronous"),
        ):
            groups = table[table.synchronised == sync].groupby("real_time_factor")
            for axes, column in ((left, "rms_drift_rad"), (right, "reached_real_time_factor")):
                values = groups[column].agg(["median", "min", "max"])
                axes.plot(values.index, values["median"], "o-", ms=4, color=colour, label=label)
                axes.fill_between(values.index, values["min"], values["max"], color=colour, alpha=0.2, lw=0)
        left.set(xlabel="real-time factor demanded", ylabel="RMS drift of the angle [rad]", xscale="log")
        factors = sorted(table.real_time_factor.unique())
        right.plot(factors, factors, ":", color="#8a8a8a", label="demanded")
        right.set(
            xlabel="real-time factor demanded", ylabel="real-time factor reached", xscale="log", yscale="log"
        )
        left.legend()
        right.legend()
    return Picture("asynchronous_drift", figure, table)


def report(table: pd.DataFrame, arguments: argparse.Namespace) -> str:
    """The README of the study."""
    parts = table.groupby(["real_time_factor", "synchronised"])
    lines = [
        f"| {factor:g} | {'yes' if sync else 'no'} | {group.rms_drift_rad.median():.3g} "
        f"| {group.rms_drift_rad.min():.3g} to {group.rms_drift_rad.max():.3g} "
        f"| {group.reached_real_time_factor.median():.3g} |"
        for (factor, sync), group in parts  # type: ignore[misc]
    ]
    rows = "\n".join(lines)
    return f"""# Asynchronous drift against the real-time factor

`python -m experiments.studies.graph.asynchronous_drift --seconds {arguments.seconds:g}
--repetitions {arguments.repetitions}`

Pendulum at 100 Hz and sensor at 50 Hz in processes of their own, agent at 20 Hz with the same open-loop commands in
every run; measurements and commands travel 20 ms. Drift: angle that the agent sees against that of the
single-process run, over {arguments.seconds:g} s of simulated time, median and range of {arguments.repetitions} runs.
Synchronised runs are equal to it bit for bit (the script checks it) and slow down where the demanded factor cannot be
reached. Asynchronous ones take what is there at their tick, so they drift: at factor 1 because a message of the same
instant comes a little later than its tick, at higher factors the more the less time a tick has. What other programs
do on the machine meanwhile enters as well: see the load average.

| real-time factor | synchronised | RMS drift [rad] | range | reached |
|---|---|---|---|---|
{rows}

![drift](asynchronous_drift.png)"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; return the exit status."""
    assert __doc__
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/graph/asynchronous_drift"))
    parser.add_argument("--factors", type=float, nargs="+", default=[1, 2, 5, 10, 20, 50])
    parser.add_argument("--seconds", type=float, default=8.0, help="simulated time of a run [s]")
    parser.add_argument("--repetitions", type=int, default=5)
    return run_study(argv, parser, study)


if __name__ == "__main__":
    sys.exit(main())
