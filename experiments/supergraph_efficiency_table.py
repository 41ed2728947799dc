"""The whole table of the evaluation, cell by cell, ours and the peer's in turn; can be stopped and resumed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from deepkoco.graph.drawing.style import figure_style, write_whole
from deepkoco.output.whole_file import write_whole_text
from experiments.provenance import as_markdown
from experiments.supergraph_efficiency import Cell, measure_ours, measure_peer

SIGMAS = (0.0, 0.1, 0.2, 0.3)
KEY = ["topology", "nodes", "sigma", "seed", "method"]
ORDER = ("ours", "peer", "mcs", "gen", "top", "seq")
COLOURS = {"ours": "#0072b2", "peer": "#d55e00", "mcs": "#009e73", "gen": "#cc79a7", "seq": "#8a8a8a"}


def cells() -> Iterator[Cell]:
    """All cells, the small ones first."""
    for nodes in (2, 4, 8, 16, 32, 64):
        for topology in ("v2v", "uav"):
            for sigma in SIGMAS:
                for seed in range(3 if nodes <= 16 else 1):
                    yield Cell(topology, nodes, sigma, seed, episodes=10, length=10.0)
        if nodes == 8:
            for topology in ("unidirectional", "bidirectional", "unirandom"):
                for sigma in SIGMAS:
                    for seed in range(3):
                        yield Cell(topology, nodes, sigma, seed, episodes=5, length=100.0)


def run_table(folder: Path, python: str) -> list[str]:
    """Measure all cells that are not in the folder yet, then write tables, figure and README.

    Args:
        folder: where `cells.csv` grows, one row per cell and method.
        python: the peer's interpreter.

    Returns:
        What it says in short, a line each.

    Raises:
        PeerError: the peer is not there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "cells.csv"
    rows: Any = pd.read_csv(path) if path.exists() else pd.DataFrame(columns=pd.Index(KEY))
    done = set(rows[KEY].itertuples(index=False, name=None))
    jobs = [(cell, method) for cell in cells() for method in ORDER]
    progress = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        console=Console(stderr=True),
    )  # fmt: skip
    with progress:
        task = progress.add_task("supergraphs", total=len(jobs))
        for cell, method in jobs:
            key = (cell.topology, cell.nodes, cell.sigma, cell.seed, method)
            progress.update(task, description=f"{cell.topology} N={cell.nodes} sigma={cell.sigma} {method}")
            if key not in done:
                # Their generator takes as long for one seed as for another.
                result = (
                    measure_peer(cell, generation=cell.seed == 0, python=python)
                    if method == "peer"
                    else measure_ours(cell, method)
                )
                row = pd.DataFrame([dict(zip(KEY, key, strict=True)) | result])
                rows = row if rows.empty else pd.concat([rows, row], ignore_index=True)
                _write(path, rows.to_csv(index=False))
            progress.advance(task)
    return write_summary(rows, folder)


def write_summary(rows: Any, folder: Path) -> list[str]:
    """Write `summary.csv` (means over seeds), `efficiency.png` and `README.md`; what they say in short."""
    table = summarise(rows)
    _write(folder / "summary.csv", table.to_csv(index=False))
    figure = draw(rows)
    write_whole(
        folder / "efficiency.png",
        lambda file: figure.savefig(file, format="png", metadata={"Software": None}),
    )
    plt.close(figure)
    _write(folder / "README.md", readme(rows, table))
    return answers(rows, table)


def summarise(rows: Any) -> Any:
    """One row per topology, N and sigma: efficiencies [%] of all methods, sizes, CPU seconds, ratios to the peer."""
    cell = ["topology", "nodes", "sigma"]
    mean = rows.groupby([*cell, "method"], sort=False).mean(numeric_only=True).reset_index()
    wide = 100 * mean.pivot(index=cell, columns="method", values="efficiency")
    table = wide[list(ORDER)].copy()
    ours = mean[mean["method"] == "ours"].set_index(cell)
    peer = mean[mean["method"] == "peer"].set_index(cell)
    table["bound"], table["release_bound"] = 100 * ours["bound"], 100 * ours["release_bound"]
    gap = table["bound"] - table["peer"]
    table["gap_closed"] = ((table["ours"] - table["peer"]) / gap).where(gap > 0.5)
    both = rows.pivot(index=[*cell, "seed"], columns="method", values="efficiency")
    table["worst_seed"] = (100 * (both["ours"] - both["peer"])).groupby(cell).min()
    for name, column in (("search", "cpu_s"), ("generation", "generation_cpu_s")):
        table[f"{name}_ours_s"], table[f"{name}_peer_s"] = ours[column], peer[column]
        table[f"{name}_ratio"] = peer[column] / ours[column]
    return table.round(4).reset_index().sort_values(cell)


def draw(rows: Any) -> Figure:
    """Efficiency against the number of nodes, one panel per topology and sigma."""
    with figure_style():
        figure, axes = plt.subplots(2, 4, figsize=(12, 6), sharex=True, sharey=True)
        for line, topology in zip(axes, ("v2v", "uav"), strict=True):
            for axis, sigma in zip(line, SIGMAS, strict=True):
                chosen = rows[(rows["topology"] == topology) & (rows["sigma"] == sigma)]
                for method, colour in COLOURS.items():
                    group = chosen[chosen["method"] == method].groupby("nodes")["efficiency"]
                    mean, low, high = 100 * group.mean(), 100 * group.min(), 100 * group.max()
                    axis.plot(mean.index, mean, color=colour, label=method, marker="o", markersize=3)
                    axis.fill_between(mean.index, low, high, color=colour, alpha=0.15, linewidth=0)
                bounds = chosen[chosen["method"] == "ours"].groupby("nodes")
                for column, style in (("bound", ":"), ("release_bound", "--")):
                    limit = 100 * bounds[column].mean()
                    axis.plot(limit.index, limit, color="#222222", linestyle=style, label=column, linewidth=1)
                axis.set(title=f"{topology}, sigma = {sigma}", xscale="log", ylim=(0, 102))
                axis.set_xticks([2, 4, 8, 16, 32, 64], labels=["2", "4", "8", "16", "32", "64"])
                axis.minorticks_off()
        for axis in axes[1]:
            axis.set_xlabel("nodes N")
        for axis in axes[:, 0]:
            axis.set_ylabel("efficiency [%]")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


INTRODUCTION = """# Efficiency of supergraphs

```
scripts/peers.sh
python -m experiments.supergraph_efficiency --table --output results/graph/supergraph
```

Efficiency is the vertices that run / (|S| x passes), on the same computation graphs for all; every method
runs the same vertices in as many passes as the supervisor has steps (`seq` takes as many as it needs).
`bound`: a kind needs as many slots as its demand before some supervisor step, spread over the passes up to
it. `release_bound` also knows that a step cannot run before the supervisor steps that it depends on; nothing
with one supervisor step per pass exceeds either. V2V and UAV: 10 graphs of 10 s; rings (N = 8): 5 of 100 s.
CPU seconds of one process on a machine shared with other work, ours and the peer's in turn, compilation not
counted. The peer's result depends on the seed of Python's string hash, which is fixed here
(`PYTHONHASHSEED` = seed). The settings of the search were chosen on seeds 0 and 1.
"""
COLUMNS = (*ORDER, "bound", "release_bound")


def answers(rows: Any, table: Any) -> list[str]:
    """The four figures that were asked for, a line each."""
    rings = ~table["topology"].isin(["v2v", "uav"])
    middle = table[table["nodes"].between(4, 16) & (table["sigma"] > 0) & ~rings]
    large = table[table["nodes"] >= 16]
    paired = rows.pivot(index=KEY[:-1], columns="method", values="efficiency")
    below = int((paired["ours"] < paired["peer"] - 1e-12).sum())
    possible = ((middle["release_bound"] - middle["peer"]) / (middle["bound"] - middle["peer"])).mean()
    search, generation = large["search_ratio"], table["generation_ratio"]
    return [
        f"- cells (with seeds) in which ours is below the peer: {below} of {len(paired)}",
        "- gap between the peer and `bound` closed, mean over V2V and UAV, N = 4-16, sigma >= 0.1: "
        f"{middle['gap_closed'].mean():.0%} (up to `release_bound` it would be {possible:.0%})",
        f"- search CPU, peer / ours, N >= 16: median {search.median():.0f}, least {search.min():.0f}",
        f"- generation CPU, peer / ours: median {generation.median():.0f}, least {generation.min():.0f}",
    ]


def readme(rows: Any, table: Any) -> str:
    """What was measured, how, and the answer."""
    lines = [
        INTRODUCTION,
        *answers(rows, table),
        "",
        f"| topology | N | sigma | {' | '.join(COLUMNS)} | search CPU s ours / peer |",
        "|---" * (len(COLUMNS) + 4) + "|",
    ]
    for row in table.to_dict("records"):
        shares = " | ".join(f"{row[name]:.1f}" for name in COLUMNS)
        lines.append(
            f"| {row['topology']} | {row['nodes']} | {row['sigma']} | {shares} |"
            f" {row['search_ours_s']:.3f} / {row['search_peer_s']:.2f} |"
        )
    lines += [
        "",
        "Means over the seeds (3 for N <= 16 and the rings, 1 for more nodes), efficiencies in %. `cells.csv`: every",
        "cell, seed and method; `summary.csv`: this table with ratios; `efficiency.png`: mean and extreme seeds.",
        "",
        as_markdown(),
        "",
    ]
    return "\n".join(lines)


def _write(path: Path, text: str) -> None:
    write_whole_text(path, text)
