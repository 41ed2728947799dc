"""Efficiency of supergraphs on the graphs of the evaluation, ours and the peer's on the same ones.

    python -m experiments.benchmarks.supergraph_efficiency --topology v2v --nodes 16 --sigma 0.1 --seed 0 \
        --episodes 10 --json
    python -m experiments.benchmarks.supergraph_efficiency ... --method mcs --peer
    python -m experiments.benchmarks.supergraph_efficiency --table --output results/graph/supergraph

Times are CPU seconds of one process; ours without the compilation of the kernels, which runs first on a small
graph and is cached on disk by numba.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.graph.supergraph import (
    Partitions,
    Supergraph,
    efficiency_bound,
    find_slots,
    generational,
    grow_common,
    measure,
    measure_sequential,
    topological,
)
from experiments.benchmarks.topologies import (
    THETA,
    TOPOLOGIES,
    Episode,
    Topology,
    episode_seeds,
    generate,
    partition,
)

ROOT = Path(__file__).resolve().parents[2]
PEER_SCRIPT = Path(__file__).resolve().parent / "peers" / "supergraph_search.py"
PEER_PYTHON = os.environ.get("DEEPKOCO_PEER_PYTHON", str(ROOT / ".venv-peers" / "bin" / "python"))
METHODS: dict[str, Callable[[Partitions], Supergraph]] = {
    "ours": lambda parts: Supergraph.chain(find_slots(parts)),
    "mcs": grow_common,
    "gen": generational,
    "top": topological,
}


class PeerError(RuntimeError):
    """The peer package is missing or failed."""


@dataclass(frozen=True)
class Cell:
    """One cell of the evaluation.

    Attributes:
        topology: one of `TOPOLOGIES`.
        nodes: number of nodes N.
        sigma: noise of the delay process.
        seed: of topology and delays.
        episodes: number of graphs.
        length: of each graph [s].
    """

    topology: str
    nodes: int
    sigma: float
    seed: int
    episodes: int
    length: float


def measure_ours(cell: Cell, method: str) -> dict[str, Any]:
    """Generate the graphs, search, and measure efficiency, bounds and CPU seconds."""
    warm_up(method)
    start = time.process_time()
    topology, episodes = generate(**vars(cell))
    generated = time.process_time()
    parts = partition(topology, episodes)
    if method == "seq":
        found, searched = measure_sequential(parts), time.process_time()
    else:
        supergraph = METHODS[method](parts)
        searched = time.process_time()
        found = measure(parts, supergraph)
    return {
        "method": method,
        "size": found.size,
        "efficiency": found.efficiency,
        "cpu_s": searched - generated,
        "bound": efficiency_bound(parts),
        "release_bound": efficiency_bound(parts, releases=True),
        "generation_cpu_s": generated - start,
        "passes": found.passes,
        "work": found.work,
    }


def measure_peer(cell: Cell, generation: bool, python: str = PEER_PYTHON) -> dict[str, Any]:
    """Measure the peer package on the same graphs, in its own interpreter.

    Args:
        cell: which graphs.
        generation: also time the peer's own generator (it must draw the same graphs).
        python: interpreter that has the package.

    Raises:
        PeerError: there is no such interpreter or package, or it failed.
    """
    if not Path(python).exists():
        raise PeerError(
            f"no interpreter {python}; scripts/peers.sh makes it, or give another one by --peer-python"
        )
    topology, episodes = generate(**vars(cell))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "graphs.npz"
        export_graphs(path, cell, topology, episodes)
        # By its path: as a module it would import the packages above it, which need what the peers do not have.
        command = [python, str(PEER_SCRIPT), str(path)]
        # The peer's result depends on the hash of its vertices' names.
        environment = os.environ | {"PYTHONHASHSEED": str(cell.seed), "OMP_NUM_THREADS": "1"}
        run = subprocess.run(
            command + ["--generate"] * generation,
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
    if run.returncode != 0:
        last = run.stderr.strip().splitlines()[-1:] or [f"exit {run.returncode}"]
        hint = "; scripts/peers.sh installs it" if "No module named" in last[0] else ""
        raise PeerError(f"the peer package failed: {last[0]}{hint}")
    result = json.loads(run.stdout)
    parts = partition(topology, episodes)
    bounds = {"bound": efficiency_bound(parts), "release_bound": efficiency_bound(parts, releases=True)}
    if (result["work"], result["passes"]) != (parts.work, int(parts.passes.sum())):
        raise PeerError(
            f"the peer ran {result['work']} vertices in {result['passes']} passes, not all of {cell}"
        )
    return {"method": "peer", **result, **bounds}


def export_graphs(path: Path, cell: Cell, topology: Topology, episodes: list[Episode]) -> None:
    """Write the graphs, and what they were drawn from, as arrays."""
    arrays = {
        "episodes": np.array(len(episodes)),
        "rates": np.array(topology.rates),
        "topology": np.array(topology.edges),
        "seeds": episode_seeds(cell.seed, cell.episodes),
        "length": np.array(cell.length),
        "theta": np.array(THETA),
        "sigma": np.array(cell.sigma),
        "window": np.array(0 if topology.every else 1),
    }
    for i, episode in enumerate(episodes):
        arrays[f"vertices_{i}"] = np.stack([episode.kind, episode.seq], axis=1)
        arrays[f"edges_{i}"] = episode.edges
    np.savez(path, **arrays)  # pyright: ignore[reportArgumentType]


def warm_up(method: str) -> None:
    """Compile or load the kernels on a small graph."""
    parts = partition(*generate("v2v", 4, 0.3, 0, 2, 4.0))
    if method == "seq":
        measure_sequential(parts)
    else:
        measure(parts, METHODS[method](parts))
    if method == "ours":
        find_slots(parts, effort=20)
    efficiency_bound(parts)
    efficiency_bound(parts, releases=True)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--topology", choices=TOPOLOGIES, default="v2v")
    parser.add_argument("--nodes", type=int, default=16)
    parser.add_argument("--sigma", type=float, default=0.1, help="noise of the delay process")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--length", type=float, default=10.0, help="of an episode [s]")
    parser.add_argument("--method", choices=(*METHODS, "seq"), default="ours")
    parser.add_argument("--peer", action="store_true", help="measure the peer package on the same graphs too")
    parser.add_argument("--peer-python", default=PEER_PYTHON, help="its interpreter (DEEPKOCO_PEER_PYTHON)")
    parser.add_argument("--generation", action="store_true", help="time the peer's generator as well")
    parser.add_argument("--table", action="store_true", help="all cells; skips those that are done")
    parser.add_argument("--output", type=Path, default=Path("results/graph/supergraph"), help="of --table")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    if options.nodes < 2 or options.episodes < 1 or options.length < 1 or not 0 <= options.sigma < 10:
        parser.error("nodes >= 2, episodes >= 1, length >= 1 s and 0 <= sigma < 10 wanted")
    try:
        if options.table:
            from experiments.benchmarks.supergraph_efficiency_table import run_table

            print("\n".join(run_table(options.output, options.peer_python)))
            return 0
        cell = Cell(
            options.topology, options.nodes, options.sigma, options.seed, options.episodes, options.length
        )
        result = measure_ours(cell, options.method)
        if options.peer:
            result = {**measure_peer(cell, options.generation, options.peer_python), "ours": result}
    except PeerError as error:
        print(f"supergraph_efficiency: {error}", file=sys.stderr)
        return 2
    if options.json:
        print(json.dumps(result))
        return 0
    for row in [result.pop("ours"), result] if options.peer else [result]:
        print(
            f"{row['method']:>5}  |S| {row['size']:4d}  efficiency {row['efficiency']:6.1%}  bound {row['bound']:6.1%}"
            f"  (with releases {row['release_bound']:6.1%})  search {row['cpu_s']:.3f} CPU s"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
