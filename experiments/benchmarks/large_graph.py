"""A platoon of 100 nodes: build, draw delays, merge and run; wall and CPU time of each phase, peak memory.

python -m experiments.benchmarks.large_graph --nodes 100 --seconds 10 --environments 256 --json
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph import BatchedRuntime, Connection, Gaussian, Graph, Input, Node, Supervisor, draw_timing
from experiments.benchmarks.topologies import make_topology


class Average(Node):
    """Follows the mean of what it sees, from a random start."""

    def init(self, parameters: Any, generator: torch.Generator, batch: int) -> dict[str, Tensor]:
        return {"x": torch.rand(batch, 1, generator=generator)}

    def initial_output(self, parameters: Any, state: dict[str, Tensor], batch: int) -> Tensor:
        return state["x"]

    def step(
        self, parameters: Any, state: dict[str, Tensor], inputs: dict[str, Input]
    ) -> tuple[dict[str, Tensor], Tensor]:
        seen = torch.stack([i.data[:, -1] for i in inputs.values()]).mean(dim=0)
        x = 0.9 * state["x"] + 0.1 * seen
        return {"x": x}, x


def make_platoon(nodes: int) -> Graph:
    """The V2V topology with jitter: followers and leader at 20 Hz, simulator at 200 Hz, the leader supervises."""
    topology = make_topology("v2v", nodes, np.random.default_rng(0))
    names = ["leader", *(f"vehicle{n}" for n in range(1, nodes - 1)), "simulator"]
    members: list[Node] = [Supervisor("leader", topology.rates[0], initial_action=torch.zeros(1))]
    for name, rate in zip(names[1:], topology.rates[1:], strict=True):
        # Computation takes most of the period, now and then more than it.
        members.append(Average(name, rate, Gaussian(0.7 / rate, 0.15 / rate), scheduling="phase"))
    connections = [
        Connection(
            names[a], names[b], Gaussian(0.2 / topology.rates[a], 0.1 / topology.rates[a]), skip=a >= b
        )
        for a, b in topology.edges
    ]
    return Graph(members, connections, supervisor="leader")


def run(nodes: int, seconds: float, environments: int, schedules: int, seed: int) -> dict[str, Any]:
    """Build, draw, merge and run one platoon.

    Args:
        nodes: number of nodes, simulator included.
        seconds: duration of an episode [s].
        environments: batch B.
        schedules: different draws of all delays that the environments share.
        seed: of delays and starts.
    """
    times: dict[str, float] = {}
    start = time.perf_counter(), time.process_time()

    def lap(name: str) -> None:
        nonlocal start
        now = time.perf_counter(), time.process_time()
        times[f"{name}_s"], times[f"{name}_cpu_s"] = now[0] - start[0], now[1] - start[1]
        start = now

    graph = make_platoon(nodes)
    lap("build")
    steps = round(seconds * float(graph.node(graph.supervisor).rate))
    timing = draw_timing(graph, np.random.default_rng(seed), steps, environments, rows=schedules)
    lap("timing")
    runtime = BatchedRuntime(graph, timing)
    lap("merge")
    state, inputs = runtime.reset({}, torch.Generator().manual_seed(seed))
    for _ in range(steps):
        action = torch.stack([i.data[:, -1] for i in inputs.values()]).mean(dim=0)
        state, inputs = runtime.step(state, action)
    lap("run")
    schedule = state.schedule
    ran = int((schedule.table >= 0).sum()) + schedules * steps
    if not all(torch.isfinite(own["x"]).all() for own in state.nodes.values() if own):
        raise RuntimeError("a state is not finite")
    return {
        "nodes": nodes,
        "connections": len(graph.connections),
        "environments": environments,
        "schedules": schedules,
        "supervisor_steps": steps,
        "slots": len(schedule.slots) + 1,
        "efficiency": ran / (schedules * (steps + 1) * (len(schedule.slots) + 1)),
        "node_steps_per_cpu_s": ran / schedules * environments / times["run_cpu_s"],
        **times,
        "total_s": sum(v for k, v in times.items() if not k.endswith("_cpu_s")),
        "total_cpu_s": sum(v for k, v in times.items() if k.endswith("_cpu_s")),
        "peak_memory_MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--nodes", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of an episode")
    parser.add_argument("--environments", type=int, default=256)
    parser.add_argument("--schedules", type=int, default=16, help="different draws of all delays")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    if options.nodes < 3 or options.environments < 1 or options.seconds < 0.05:
        parser.error("nodes >= 3, environments >= 1 and seconds >= 0.05 wanted")
    if not 1 <= options.schedules <= options.environments:
        parser.error("1 <= schedules <= environments wanted")
    result = run(options.nodes, options.seconds, options.environments, options.schedules, options.seed)
    if options.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name:20} {value:.4g}" if isinstance(value, float) else f"{name:20} {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
