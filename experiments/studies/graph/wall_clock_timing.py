"""How well 100 Hz nodes keep real time on this machine: jitter of the ticks, overruns, lost messages.

    python -m experiments.studies.graph.wall_clock_timing --out results/graph/wall_clock_timing

A pendulum, a sensor, a filter and an agent, all at the same rate, run in the wall-clock runtime: in processes,
in processes with real-time priority where that is permitted, and in threads.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from deepkoco.graph import Connection, Episode, Graph, Supervisor
from deepkoco.graph.live import WallClockRuntime, message_times, node_times
from experiments.studies.graph.live_study import PendulumWorld, Relay, load, run_study

# Tables and figures are imported where they are made: the processes of the nodes import this module, too.
if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from deepkoco.graph.drawing.style import Picture

SETUPS: dict[str, dict[str, Any]] = {
    "processes": {},
    "processes, priority": {"priority": 20},
    "threads": {"threads": ("world", "sensor", "filter")},
}


def robot(rate: float) -> Graph:
    """World, sensor, filter and agent; from the start of a step to the arrival of its message 1 ms is expected."""
    action = torch.zeros(1, dtype=torch.float64)
    return Graph(
        [
            PendulumWorld("world", rate),
            Relay("sensor", rate),
            Relay("filter", rate),
            Supervisor("agent", rate, initial_action=action),
        ],
        [
            Connection("world", "sensor", 0.001),
            Connection("sensor", "filter", 0.001),
            Connection("filter", "agent", 0.001),
            Connection("agent", "world", 0.001, skip=True),
        ],
    )


def record(graph: Graph, steps: int, options: dict[str, Any]) -> tuple[Episode, bool]:
    """Run an episode; return it and whether real-time priority was granted."""
    action = torch.zeros(1, 1, dtype=torch.float64)
    with WallClockRuntime(graph, time_limit=5.0, beat_limit=5.0, **options) as runtime:
        runtime.reset({}, torch.Generator())
        runtime.run(lambda _: action, steps)
        return runtime.finish(), runtime.priority_granted


def study(arguments: argparse.Namespace) -> tuple[list[Picture], str]:
    """Record the setups one after the other."""
    import pandas as pd

    from deepkoco.graph.drawing.style import Picture

    graph = robot(arguments.rate)
    nodes, messages, lateness = [], [], {}
    for setup, options in SETUPS.items():
        episode, priority = record(graph, round(arguments.seconds * arguments.rate), options)
        label = setup if "priority" not in options or priority else f"{setup} (refused)"
        for name in graph.index:
            times = node_times(graph, episode, name)
            nodes.append(
                {
                    "setup": label,
                    "node": name,
                    "ticks": times.steps,
                    "overruns": times.overruns,
                    **_spread("lateness_ms", times.lateness),
                    "period_sd_ms": float(times.period.std() * 1e3),
                    **_spread("computation_ms", times.computation),
                    "load_average": load(),
                }
            )
            lateness[label, name] = times.lateness * 1e3
        for connection in graph.connections:
            counted = message_times(graph, episode, connection.key)
            messages.append(
                {
                    "setup": label,
                    "connection": connection.key,
                    "sent": counted.sent,
                    "lost": counted.lost,
                    "unseen": counted.unseen,
                    **_spread("delay_ms", counted.delay),
                }
            )
    ticks, ways = pd.DataFrame(nodes), pd.DataFrame(messages)
    pictures = [
        draw("lateness", "start after the tick [ms]", lateness, ticks),
        Picture("messages", _draw_delays(ways), ways),
    ]
    return pictures, report(ticks, ways, arguments)


def _spread(name: str, seconds: np.ndarray) -> dict[str, float]:
    points = np.percentile(seconds * 1e3, [50, 99, 100])
    return {f"{name}_{part}": float(p) for part, p in zip(("median", "p99", "max"), points, strict=True)}


def draw(name: str, label: str, values: dict[tuple[str, str], np.ndarray], table: pd.DataFrame) -> Picture:
    """Histograms, one panel for each setup."""
    from matplotlib.figure import Figure

    from deepkoco.graph.drawing.style import PALETTE, Picture, figure_style

    setups = list(dict.fromkeys(setup for setup, _ in values))
    with figure_style():
        figure = Figure(figsize=(4 * len(setups), 3.2))
        panels = figure.subplots(1, len(setups), sharex=True, sharey=True, squeeze=False)[0]
        edges = np.logspace(-2, 2, 60)
        for axes, setup in zip(panels, setups, strict=True):
            for colour, (key, numbers) in zip(
                PALETTE, ((k, v) for k, v in values.items() if k[0] == setup), strict=False
            ):
                axes.hist(
                    np.clip(numbers, edges[0], edges[-1]),
                    edges,
                    histtype="step",
                    color=colour,
                    label=key[1],
                    lw=1.4,
                )
            axes.set(title=setup, xlabel=label, xscale="log", yscale="log")
        panels[0].set_ylabel("ticks")
        panels[0].legend(fontsize=8)
    return Picture(name, figure, table)


def _draw_delays(ways: pd.DataFrame) -> Figure:
    from matplotlib.figure import Figure

    from deepkoco.graph.drawing.style import PALETTE, figure_style

    with figure_style():
        figure = Figure(figsize=(6, 3.2))
        axes = figure.subplots()
        setups = list(ways.setup.unique())
        for colour, setup in zip(PALETTE, setups, strict=False):
            part = ways[ways.setup == setup]
            place = np.arange(len(part)) + 0.2 * setups.index(setup)
            axes.plot(place, part.delay_ms_median, "o", color=colour, label=setup)
            axes.vlines(place, part.delay_ms_median, part.delay_ms_p99, color=colour)
        names = list(ways.connection.unique())
        axes.set_xticks(np.arange(len(names)) + 0.2, names)
        axes.set(ylabel="delay of a message,\nmedian to 99 % [ms]", yscale="log")
        axes.legend(fontsize=8)
    return figure


def report(ticks: pd.DataFrame, ways: pd.DataFrame, arguments: argparse.Namespace) -> str:
    """The README of the study."""
    rows = "\n".join(
        f"| {r['setup']} | {r['node']} | {r['ticks']} | {r['overruns']} | {r['lateness_ms_median']:.3f} "
        f"| {r['lateness_ms_p99']:.3f} | {r['lateness_ms_max']:.2f} | {r['period_sd_ms']:.3f} |"
        for r in ticks.to_dict("records")
    )
    lines = "\n".join(
        f"| {r['setup']} | {r['connection']} | {r['sent']} | {r['lost']} | {r['unseen']} | {r['delay_ms_median']:.3f} "
        f"| {r['delay_ms_p99']:.3f} |"
        for r in ways.to_dict("records")
    )
    return f"""# Nodes at {arguments.rate:g} Hz in real time

`python -m experiments.studies.graph.wall_clock_timing --rate {arguments.rate:g} --seconds {arguments.seconds:g}`

World, sensor, filter and agent on an absolute schedule; the agent is in the caller's thread. Lateness: start of a step
after its tick. Overrun: a step longer than a period. Unseen: messages that arrived and that no step saw because a newer
one had come. Each tick is one step: none is run twice and none is left out.

| setup | node | ticks | overruns | lateness median [ms] | 99 % | largest | sd of the period [ms] |
|---|---|---|---|---|---|---|---|
{rows}

| setup | connection | sent | lost | unseen | delay median [ms] | 99 % |
|---|---|---|---|---|---|---|
{lines}

![lateness](lateness.png)
![delays](messages.png)"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; return the exit status."""
    assert __doc__
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/graph/wall_clock_timing"))
    parser.add_argument("--rate", type=float, default=100.0, help="of all nodes [Hz]")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each setup's run [s]")
    return run_study(argv, parser, study)


if __name__ == "__main__":
    sys.exit(main())
