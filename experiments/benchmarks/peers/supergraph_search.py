"""Runs the peer package `supergraph` on computation graphs given as arrays; started in an environment of its own.

    PEER_PYTHON experiments/benchmarks/peers/supergraph_search.py GRAPHS.npz [--generate]

Reads the arrays that `export_graphs` of `experiments.benchmarks.supergraph_efficiency` wrote, prints one line of JSON.
With `--generate` the peer also draws the graphs itself; those must be the same ones. Imports nothing of ours.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import networkx as nx
import numpy as np
import supergraph  # pyright: ignore[reportMissingImports]
import supergraph.evaluate  # pyright: ignore[reportMissingImports]

BACKTRACK = 20


def main(path: str, generate: bool) -> dict[str, Any]:
    """Measure the peer: size, efficiency, CPU seconds of the search and of the generation."""
    with np.load(path, allow_pickle=False) as arrays:
        data = {name: arrays[name] for name in arrays.files}
    graphs = [_graph(data[f"vertices_{i}"], data[f"edges_{i}"]) for i in range(int(data["episodes"]))]
    start = time.process_time()
    found, _, matches = supergraph.grow_supergraph(graphs, 0, backtrack=BACKTRACK, progress_bar=False)
    cpu = time.process_time() - start
    passes = sum(1 + max(turn for turn, _ in match.values()) for match in matches)
    work = sum(len(match) for match in matches)
    result = {
        "size": len(found),
        "efficiency": work / (len(found) * passes),
        "cpu_s": cpu,
        "passes": passes,
        "work": work,
    }
    if generate:
        start = time.process_time()
        drawn = _generate(data)
        result["generation_cpu_s"] = time.process_time() - start
        for i, (ours, theirs) in enumerate(zip(graphs, drawn, strict=True)):
            if set(ours.nodes) != set(theirs.nodes) or not _same_edges(ours, theirs):
                raise SystemExit(f"episode {i}: the peer draws another graph")
    return result


def _graph(vertices: np.ndarray, edges: np.ndarray) -> nx.DiGraph:
    graph = nx.DiGraph()
    names = [f"{kind}_{seq}" for kind, seq in vertices.tolist()]
    for name, (kind, seq) in zip(names, vertices.tolist(), strict=True):
        graph.add_node(name, kind=kind, seq=seq, order=kind)
    graph.add_edges_from((names[a], names[b]) for a, b in edges.tolist())
    return graph


def _generate(data: dict[str, np.ndarray]) -> list[nx.DiGraph]:
    drawn = []
    rates = data["rates"].tolist()
    edges = {(a, b) for a, b in data["topology"].tolist()} | {(k, k) for k in range(len(rates))}
    for seed in data["seeds"].tolist():
        graph = supergraph.evaluate.create_graph(
            rates,
            edges,
            float(data["length"]),
            seed=seed,
            theta=float(data["theta"]),
            sigma=float(data["sigma"]),
            progress_bar=False,
            with_attributes=False,
        )
        graph = supergraph.evaluate.prune_by_window(graph, int(data["window"]))
        drawn.append(supergraph.evaluate.prune_by_leaf(graph, 0))
    return drawn


def _same_edges(ours: nx.DiGraph, theirs: nx.DiGraph) -> bool:
    # The peer joins the first step of a node to a later one of the same node as well: one edge too many.
    extra = set(theirs.edges) - set(ours.edges)
    return not set(ours.edges) - set(theirs.edges) and all(
        a.split("_")[0] == b.split("_")[0] for a, b in extra
    )


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], "--generate" in sys.argv[2:])))
