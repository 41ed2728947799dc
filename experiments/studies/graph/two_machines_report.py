"""Tables, figures and the README of the study of two machines."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

import numpy as np

from deepkoco.graph import Episode, Graph
from deepkoco.graph.live import message_times, node_times

if TYPE_CHECKING:
    import pandas as pd

DRIFT = 4e-5  # of the made-up clock of the second evaluation: s per s


def tables(graph: Graph, episodes: list[Episode]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Ticks by node and messages by connection, over all episodes."""
    nodes, messages = [], []
    for name in graph.index:
        times = [node_times(graph, episode, name) for episode in episodes]
        lateness = np.concatenate([t.lateness for t in times]) * 1e3
        nodes.append(
            {
                "node": name,
                "ticks": sum(t.steps for t in times),
                "overruns": sum(t.overruns for t in times),
                "median": np.median(lateness),
                "p99": np.percentile(lateness, 99),
                "max": lateness.max(),
            }
        )
    for connection in graph.connections:
        counted = [message_times(graph, episode, connection.key) for episode in episodes]
        delay = np.concatenate([c.delay for c in counted]) * 1e3
        messages.append(
            {
                "connection": connection.key,
                "sent": sum(c.sent for c in counted),
                "lost": sum(c.lost for c in counted),
                "unseen": sum(c.unseen for c in counted),
                "median": np.median(delay),
                "p99": np.percentile(delay, 99),
                "max": delay.max(),
            }
        )
    return nodes, messages


def clock_table(corrections: list[tuple[float, int, int]], ahead: int) -> pd.DataFrame:
    """Error of the robot's clock and what it said of its uncertainty, at each step [ms]."""
    import pandas as pd

    seconds, correction, uncertainty = (np.array(column) for column in zip(*corrections, strict=True))
    return pd.DataFrame(
        {"seconds": seconds, "error_ms": (correction + ahead) / 1e6, "uncertainty_ms": uncertainty / 1e6}
    )


def draw_clocks(clocks: pd.DataFrame) -> Any:
    """Error and claimed uncertainty of the robot's clock over time [ms]."""
    from matplotlib.figure import Figure

    from deepkoco.graph.drawing.style import PALETTE, figure_style

    with figure_style():
        figure = Figure(figsize=(7, 3.0))
        axes = figure.subplots()
        axes.plot(
            clocks.seconds, clocks.uncertainty_ms, color=PALETTE[1], lw=0.8, label="what it says it may be"
        )
        axes.plot(
            clocks.seconds,
            clocks.error_ms.abs(),
            color=PALETTE[0],
            lw=0.8,
            label="error of the robot's clock",
        )
        axes.axhline(0.2, color="0.6", lw=0.8)
        axes.set(xlabel="time [s]", ylabel="error [ms]", yscale="log", ylim=(1e-4, None))
        axes.legend(fontsize=8)
    return figure


def draw_kills(kills: list[dict[str, Any]]) -> Any:
    """Times from the kills to a zero command [ms]."""
    from matplotlib.figure import Figure

    from deepkoco.graph.drawing.style import PALETTE, figure_style

    kept = [row for row in kills if not row["stopped_before"]]
    names = list(dict.fromkeys(f"{row['killed']}, {row['signal']}" for row in kept))
    with figure_style():
        figure = Figure(figsize=(6, 3.0))
        axes = figure.subplots()
        for colour, name in zip(PALETTE, names, strict=False):
            times = [row["zero_after_kill_ms"] for row in kept if f"{row['killed']}, {row['signal']}" == name]
            axes.plot(times, [name] * len(times), "o", color=colour)
        axes.axvline(100.0, color="0.6", lw=0.8)
        axes.set(xlabel="from the kill to zero command [ms]", xlim=(0, None))
    return figure


def report(
    arguments: argparse.Namespace,
    nodes: list[dict[str, Any]],
    messages: list[dict[str, Any]],
    clocks: pd.DataFrame,
    stops: list[str],
    kills: list[dict[str, Any]],
    drifted: np.ndarray,
    silence: float,
    ahead: int,
    used: float,
) -> str:
    """The README of the study."""
    ticks = "\n".join(
        f"| {r['node']} | {r['ticks']} | {r['overruns']} | {r['median']:.3f} | {r['p99']:.3f} | {r['max']:.2f} |"
        for r in nodes
    )
    ways = "\n".join(
        f"| {r['connection']} | {r['sent']} | {r['lost']} | {r['unseen']} | {r['median']:.3f} | {r['p99']:.3f} "
        f"| {r['max']:.2f} |"
        for r in messages
    )
    kept = [row for row in kills if not row["stopped_before"]]
    killed = "\n".join(
        f"| {r['killed']} | {r['signal']} | {r['zero_after_kill_ms']:.1f} | {r['zero_after_last_command_ms']:.1f} "
        f"| {r['load_average']:.1f} |"
        for r in kept
    )
    ended = "\n".join(f"- session {k}: {reason}" for k, reason in enumerate(stops))
    error, uncertain = clocks.error_ms.abs(), clocks.uncertainty_ms
    moved = np.abs(drifted[:, 0]) / 1e6
    day = (
        f"{ahead / 1e9:g} s ahead of the leader's"
        if ahead
        else "the leader's own (no time namespace permitted)"
    )
    before = len(kills) - len(kept)
    return f"""# Two machines at 100 Hz

`python -m experiments.studies.graph.two_machines --seconds {arguments.seconds:g} --kills {arguments.kills} \
--seed {arguments.seed}`

Both ends on this machine over 127.0.0.1, as the page on two machines starts them: a unit with world and sensor at
`deepkoco serve`, the agent at the end that leads. The robot's monotonic clock is {day}, so the truth is known.
{len(stops)} session(s), {used:.0f} processor seconds of the leading end and what it waited for.

{ended}

| node | ticks | overruns | lateness median [ms] | 99 % | largest |
|---|---|---|---|---|---|
{ticks}

| connection | sent | lost | unseen | delay median [ms] | 99 % | largest |
|---|---|---|---|---|---|---|
{ways}

Longest silence of the connection: {1e3 * silence:.0f} ms (limit 60 ms).

| clock of the robot, at each step of the agent | median [ms] | 99 % | largest |
|---|---|---|---|
| error | {error.median():.4f} | {error.quantile(0.99):.4f} | {error.max():.4f} |
| what it said it may be | {uncertain.median():.4f} | {uncertain.quantile(0.99):.4f} | {uncertain.max():.4f} |
| error of the estimate if the clock were {DRIFT * 1e6:g} ppm fast (same exchanges) | {np.median(moved):.4f} \
| {np.percentile(moved, 99):.4f} | {moved.max():.4f} |

![clocks](clocks.png)

## Ten kills

A witness in a process outside of both ends plays the drive: it writes down when each command comes, and when a zero
comes or the connection of the motor's process ends. SIGSTOP leaves the connection open and silent, as a pulled cable
does.
{before} run(s) had stopped by themselves before the kill, by the limit of 60 ms, and were repeated.

| killed | signal | zero command after the kill [ms] | after the motor's last [ms] | load average |
|---|---|---|---|---|
{killed}

![kills](kills.png)"""
