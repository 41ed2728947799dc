"""Everything about the speed of the graph, against its peers.

    python -m experiments.benchmarks.graph_benchmark [--out FOLDER]

Runs the benchmarks one after the other, each ours and the peer's in turn on the same work, keeps what each
prints beside its CSV, and writes a page that says where the figures come from. The peers are installed first,
into environments of their own (`scripts/peers.sh`). A benchmark that is done is skipped, so an interrupted run
goes on where it was; delete its text file to repeat it. On two cores all of it takes about 25 minutes, most of
them in the peer's searches.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from rich.console import Console

from deepkoco.output.whole_file import whole_file, write_whole_text
from experiments.plumbing.provenance import as_markdown

WIDE = 140  # characters of a line of the tables
BATCHES = ("1", "16", "64", "256", "1024", "4096", "16384")


def benchmarks(folder: Path) -> dict[str, tuple[str, list[str]]]:
    """Title and module with arguments of each benchmark, by the name of its text file."""
    return {
        "rollout": (
            "Rollouts against REX: agent steps per second, start-up, memory, population",
            ["experiments.benchmarks.rollout_speed", "--batch", *BATCHES, "--peer", "--start-up", "--population",
             "--out", str(folder / "rollout.csv")],
        ),
        "roofline": (
            "What a loop by hand reaches on this machine, and the kernel in the same run",
            ["experiments.benchmarks.roofline", "--out", str(folder / "roofline.csv")],
        ),
        "delay_cost": (
            "What random delays cost",
            ["experiments.benchmarks.delay_cost", "--out", str(folder / "delay_cost.csv")],
        ),
        "population": (
            "A population of models on both cores, against REX, which always uses them",
            ["experiments.benchmarks.rollout_speed", "--executors", "fused", "--batch", "64", "--peer", "--population",
             "--threads", "2", "--out", str(folder / "population.csv")],
        ),
        "single_environment": (
            "One environment through Gymnasium, against Pendulum-v1 and EAGERx",
            ["experiments.benchmarks.single_environment", "--peer", "--out", str(folder / "single_environment.csv")],
        ),
        "large_graph": ("A hundred nodes, 256 environments", ["experiments.benchmarks.large_graph"]),
        "supergraph": (
            "Supergraphs against the peer package",
            ["experiments.benchmarks.supergraph_efficiency", "--table", "--output", str(folder / "supergraph")],
        ),
    }  # fmt: skip


def run(console: Console, module: list[str], text: Path) -> bool:
    """Run one benchmark, show what it prints and keep it in a file once it has succeeded."""
    # Its tables are wider than what a program that writes to a pipe believes to have.
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": str(WIDE)}
    partial = text.with_name(f".{text.name}.partial")
    with partial.open("w", encoding="utf-8") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", *module], env=environment, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        for line in process.stdout:
            console.print(line, end="", markup=False, highlight=False, soft_wrap=True)
            file.write(line)
    if process.wait() != 0:
        partial.unlink()
        return False
    os.replace(partial, text)
    return True


def draw_rollouts(table: Path) -> None:
    """Draw steps per CPU second against the batch, beside the CSV that they come from."""
    data = pd.read_csv(table)
    data = data[data["work"] == "rollout"]
    figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
    for i, (executor, own) in enumerate(data.groupby("executor", sort=False)):
        axis.plot(own["batch"], own["steps_per_cpu_s"], "o-", color=f"C{i}", label=executor)
        axis.fill_between(
            own["batch"], own["steps_per_cpu_s_low"], own["steps_per_cpu_s_high"], color=f"C{i}", alpha=0.2
        )
    axis.set(xscale="log", yscale="log", xlabel="environments", ylabel="agent steps per CPU second")
    axis.grid(alpha=0.3)
    axis.legend(title="median and quartiles")
    with whole_file(table.with_suffix(".png")) as partial:
        figure.savefig(partial, dpi=150, format="png")
    plt.close(figure)


def write_readme(folder: Path) -> None:
    """Collect what the benchmarks printed, with the versions and the machine."""
    parts = ["# The delay graph: speed and size, against its peers", ""]
    parts += ["Made by `make bench`. Beside each table lies the CSV of every single measurement.", ""]
    for name, (title, module) in benchmarks(Path("results/graph")).items():
        text = folder / f"{name}.txt"
        if text.exists():
            command = f"python -m {' '.join(module)}"
            parts += [f"## {title}", "", f"`{command}`", "", "```", text.read_text().rstrip(), "```", ""]
    if (folder / "rollout.csv").exists():
        draw_rollouts(folder / "rollout.csv")
        parts += ["![agent steps per CPU second against the number of environments](rollout.png)", ""]
    parts += ["## Made with", "", as_markdown(), ""]
    write_whole_text(folder / "BENCHMARK.md", "\n".join(parts))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.benchmarks.graph_benchmark", description=__doc__
    )
    parser.add_argument(
        "--out", type=Path, default=Path("runs/graph_benchmark"), help="folder to write or go on in"
    )
    parser.add_argument("--only", nargs="+", choices=tuple(benchmarks(Path())), help="run these alone")
    options = parser.parse_args(arguments)
    folder: Path = options.out
    folder.mkdir(parents=True, exist_ok=True)
    console = Console()
    root = Path(__file__).resolve().parents[2]
    subprocess.run([root / "scripts" / "peers.sh"], cwd=root, check=True)
    failed = []
    for name, (title, module) in benchmarks(folder).items():
        text = folder / f"{name}.txt"
        if (options.only and name not in options.only) or text.exists():
            continue
        console.rule(title)
        if not run(console, module, text):
            failed.append(name)
    write_readme(folder)
    if failed:
        console.print(f"failed: {', '.join(failed)}; run the command above to see why", style="red")
    console.print(f"{folder / 'BENCHMARK.md'}")
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
