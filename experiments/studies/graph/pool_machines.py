"""A pool's log and its runtimes: the volume of the pipe from a recording, and the same nodes in every runtime."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.envs.pool import PoolOptions, pool_graph, pool_start
from deepkoco.fit.graph_fit import fit_graph, seen_by_supervisor
from deepkoco.graph import Episode, Graph, Input, draw_timing, replay_episode
from deepkoco.graph.live import ConcurrentRuntime, SimulatedRuntime, WallClockRuntime
from deepkoco.graph.live.live import LiveRuntime
from deepkoco.systems.fluids import pool_parameters

if TYPE_CHECKING:
    import pandas as pd

BOUNDS = (0.02, 0.12)  # of the pipe [m3]
LOG_STEPS = 360
SHARED = ("probe", "delay", "kalman", "pid", "heater", "pump")  # light nodes, in threads of the caller
FACTOR = 20.0


def identified(seeds: int) -> pd.DataFrame:
    """Find the volume of a pipe from a log in which pump and heater change."""
    import pandas as pd

    rows = []
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        true = float(random.uniform(0.03, 0.1))
        parameters = pool_parameters()
        parameters["world"]["pipe_volume"] = torch.tensor(true, dtype=torch.float64)
        levels = np.repeat(random.uniform([0.0, 0.2], [1.0, 1.0], (LOG_STEPS // 12, 2)), 12, axis=0)
        recorded = pool_graph(PoolOptions())
        start = pool_start(recorded, *(torch.tensor([v], dtype=torch.float64) for v in (28.0, 30.0)))
        commands = iter(torch.from_numpy(levels)[:, None])
        with SimulatedRuntime(recorded, draw_timing(recorded, random, LOG_STEPS, 1)) as runtime:
            runtime.reset(parameters, torch.Generator().manual_seed(seed), start)
            runtime.run(lambda _, commands=commands: next(commands), LOG_STEPS)
            episode = runtime.finish()
        model = pool_graph(PoolOptions(noise=False))
        shown = seen_by_supervisor(recorded, episode, "probe->agent")
        measured = recorded.parts["probe"].split_array(shown)["temperature"]
        begin = time.process_time()
        nominal = pool_parameters()
        nominal["world"].pop("pipe_volume")
        fit = fit_graph(
            model, episode, nominal, {"world.pipe_volume": BOUNDS}, {"measured": measured}, {"measured": 0.05},
            initial=start, population=16, generations=25, seed=seed,
        )  # fmt: skip
        found = fit.estimates["world.pipe_volume"]
        rows.append(
            {"seed": seed, "true_m3": true, "value_m3": found.value, "low_m3": found.low, "high_m3": found.high,
             "seconds": time.process_time() - begin}
        )  # fmt: skip
    return pd.DataFrame(rows)


def act(inputs: dict[str, Input]) -> Tensor:
    """The goal 29 deg C; the pump slows down after 30 s."""
    pump = torch.where(inputs["truth"].t_start < 30.0, 1.0, 0.3).double()
    return torch.stack([torch.full_like(pump, 29.0), pump], -1)


def same_in_every_runtime(settings: dict[str, Any], wall_clock_steps: int) -> pd.DataFrame:
    """Run the nodes event by event, in threads and processes, and by the clock; replay each record."""
    import pandas as pd

    graph = pool_graph(PoolOptions(filter="flow", controlled=True, **settings))
    steps = 30
    timing = draw_timing(graph, np.random.default_rng(0), steps, 1)
    reference, _ = _run(SimulatedRuntime(graph, timing), graph, steps)
    runtimes: dict[str, tuple[Any, int]] = {
        "simulated": (lambda: SimulatedRuntime(graph, timing), steps),
        "threads and a process, in step": (
            lambda: ConcurrentRuntime(graph, timing, processes={"world": 1}),
            steps,
        ),
        f"threads, by the clock, {FACTOR:g} times as fast": (
            lambda: ConcurrentRuntime(graph, sync=False, real_time_factor=FACTOR),
            steps,
        ),
        "processes, by the clock, real time": (
            lambda: WallClockRuntime(graph, threads=SHARED, beat_limit=20.0, time_limit=20.0),
            wall_clock_steps,
        ),
    }
    rows = []
    for name, (make, count) in runtimes.items():
        episode, seconds = _run(make(), graph, count)
        start = pool_start(graph, *_start())
        again, _ = replay_episode(graph, episode, {}, torch.Generator().manual_seed(1), start)
        same = all(np.array_equal(again.outputs[node], outputs) for node, outputs in episode.outputs.items())
        pools = [graph.parts["world"].split_array(e.outputs["world"])["pool"] for e in (reference, episode)]
        both = min(map(len, pools))
        rows.append(
            {"runtime": name, "simulated_s": 10.0 * count, "real_s": seconds,
             "difference_K": float(np.abs(pools[0][:both] - pools[1][:both]).max()),
             "replay": "bit for bit" if same else "differs"}
        )  # fmt: skip
    return pd.DataFrame(rows)


def _start() -> tuple[Tensor, Tensor]:
    return torch.tensor([28.5], dtype=torch.float64), torch.tensor([29.0], dtype=torch.float64)


def _run(runtime: SimulatedRuntime | LiveRuntime, graph: Graph, steps: int) -> tuple[Episode, float]:
    with runtime:
        runtime.reset({}, torch.Generator().manual_seed(1), pool_start(graph, *_start()))
        begin = time.monotonic()
        runtime.run(act, steps)
        seconds = time.monotonic() - begin
        return runtime.finish(), seconds
