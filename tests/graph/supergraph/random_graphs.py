"""Random graphs and their timings, many and quickly, and a plain execution in numpy to compare with."""

import numpy as np
import torch

from deepkoco.graph import Connection, Gaussian, Graph, Mixture, Node, Supervisor, draw_timing
from deepkoco.graph.timing.computation_graph import ComputationGraph


class Plain(Node):
    """Never steps: these tests execute in numpy."""

    def init(self, parameters, generator, batch):
        return {}

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1)

    def step(self, parameters, state, inputs):
        raise AssertionError("not run here")


def random_timing(seed: int, rows: int = 3) -> tuple[ComputationGraph, ComputationGraph]:
    """Draw a graph of 2 to 6 nodes and two timings of it, of as many supervisor steps."""
    generator = np.random.default_rng(seed)
    size = int(generator.integers(2, 7))
    rates = [10, 20, 25, 50, 100]
    delays = [
        0.0,
        0.01,
        0.025,
        0.06,
        Gaussian(0.03, 0.03),
        Mixture((Gaussian(0.01, 0.004), Gaussian(0.08, 0.03)), (0.7, 0.3)),
    ]

    def pick(values):
        return values[int(generator.integers(len(values)))]

    supervisor = int(generator.integers(size))
    nodes = []
    for n in range(size):
        options = {"rate": pick(rates), "scheduling": pick(["frequency", "phase"])}
        if generator.random() < 0.5:
            options["delay"] = pick(delays[:5])
        if n == supervisor:
            nodes.append(Supervisor("agent", initial_action=torch.zeros(1), **options))
        else:
            nodes.append(Plain(f"n{n}", **options))
    connections = []
    for a in range(size):
        for b in range(size):
            if a != b and (generator.random() < 0.5 or b == a + 1):
                connections.append(
                    Connection(
                        nodes[a].name,
                        nodes[b].name,
                        pick(delays),
                        window=int(generator.integers(1, 4)),
                        skip=a > b or generator.random() < 0.2,
                        blocking=bool(generator.random() < 0.25),
                        fifo=bool(generator.random() < 0.8),
                    )
                )
    graph = Graph(nodes, connections)
    steps = int(generator.integers(1, 7))
    return (
        draw_timing(graph, np.random.default_rng(seed + 1), steps, rows, rows=rows),
        draw_timing(graph, np.random.default_rng(seed + 2), steps, rows, rows=rows),
    )


def squash(x):
    """Mix the bits by operations that are rounded alike for arrays and numbers."""
    return x / (1 + abs(x)) * 3


def plain_execution(timing: ComputationGraph, row: int) -> dict[tuple[int, int], float]:
    """Run one schedule step by step in the order in which they start; outputs by node and step."""
    layout = timing.layout
    into = [np.flatnonzero(layout.receiver == n) for n in range(len(layout.names))]
    state = dict.fromkeys(range(len(layout.names)), 0.5)
    outputs: dict[tuple[int, int], float] = {}
    waiting = [(n, 0) for n in range(len(layout.names)) if timing.count(row, n)]
    while waiting:
        progressed = []
        for n, k in waiting:
            seen = [(int(layout.sender[e]), timing.windows_of(e, row)[k].tolist()) for e in into[n]]
            if any(s >= 0 and (a, s) not in outputs for a, window in seen for s in window):
                progressed.append((n, k))
                continue
            for a, window in seen:
                for s in window:
                    state[n] = state[n] * 0.75 + (outputs[a, s] if s >= 0 else 0.125 * a)
            outputs[n, k] = squash(state[n] + n + 0.01 * k)
            if k + 1 < timing.count(row, n):
                progressed.append((n, k + 1))
        assert progressed != waiting, "the timing has a cycle"
        waiting = progressed
    return outputs


def masked_execution(timing: ComputationGraph, merged) -> list[dict[tuple[int, int], float]]:
    """Run all schedules of a timing slot by slot under masks, with `depth` cells for outputs."""
    layout, rows = timing.layout, len(timing.boundary)
    nodes = len(layout.names)
    into = [np.flatnonzero(layout.receiver == n) for n in range(nodes)]
    state = np.full((rows, nodes), 0.5)
    cells = [np.full((rows, int(merged.depth[n])), 0.125 * n) for n in range(nodes)]
    outputs: list[dict[tuple[int, int], float]] = [{} for _ in range(rows)]

    def run(n: int, seq: np.ndarray) -> None:
        mask = np.flatnonzero(seq >= 0)
        k = seq[mask]
        value = state[mask, n]
        for e in into[n]:
            for i in range(layout.window[e]):
                column = layout.window_base[e] + k * layout.window[e] + i
                s = timing.windows[mask, column]
                a = layout.sender[e]
                value = value * 0.75 + cells[a][mask, s % cells[a].shape[1]]
        state[mask, n] = value
        value = squash(value + n + 0.01 * k)
        cells[n][mask, k % cells[n].shape[1]] = value
        for row, step, output in zip(mask.tolist(), k.tolist(), value.tolist(), strict=True):
            assert (n, step) not in outputs[row]
            outputs[row][n, step] = output

    for j in range(timing.steps + 1):
        for slot, n in enumerate(merged.slots.tolist()):
            run(n, merged.table[:, j, slot].astype(np.int64))
        run(layout.supervisor, np.full(rows, j))
    return outputs
