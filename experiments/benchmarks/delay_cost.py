"""What random delays cost: `python -m experiments.benchmarks.delay_cost [--batch 1024] [--out delay_cost.csv]`.

The benchmark's pendulum without delays, with random delays of 20 schedules that the environments share, and with a
schedule of its own for every environment, all below a control step and drawn anew for every message. They take turns in
one run, with given actions and with the policy of 2 x 64 tanh units. The ratio is one of processor time in a repeat.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from deepkoco.graph import BatchedRuntime, draw_timing
from deepkoco.output.whole_file import whole_file
from experiments.benchmarks import rollout_work

STEPS = 200
SCHEDULES = 20
NONE, SHARED, OWN = "none", f"{SCHEDULES} schedules", "of each environment its own"


def prepare(delays: str, batch: int, policy: bool) -> Callable[[], None]:
    """A rollout that can be repeated."""
    rows = {NONE: 1, SHARED: SCHEDULES, OWN: batch}[delays]
    graph = rollout_work.make_graph(delays != NONE)
    timing = draw_timing(graph, np.random.default_rng(0), STEPS, rows, rows=rows)
    runtime = BatchedRuntime(graph, timing, executor="fused")
    chosen = np.arange(batch) if delays == OWN else np.random.default_rng(1).integers(rows, size=batch)
    state, _ = runtime.reset(rollout_work.make_parameters(), torch.Generator().manual_seed(0), rows=chosen)
    actions = torch.randn(STEPS, batch, 1, generator=torch.Generator().manual_seed(1))
    work = rollout_work.make_policy() if policy else actions

    def run() -> None:
        with torch.no_grad():
            runtime.rollout(state, work, STEPS, record=())

    run()
    return run


def measure(batch: int, policy: bool, repeats: int) -> list[dict[str, object]]:
    """CPU seconds of each kind of delays in turns: medians, and the quartiles of the ratio to none."""
    runs = {delays: prepare(delays, batch, policy) for delays in (NONE, SHARED, OWN)}
    times = max(1, 2_000_000 // (batch * STEPS))
    seconds: dict[str, list[float]] = {delays: [] for delays in runs}
    for _ in range(repeats):
        for delays, run in runs.items():
            begin = time.process_time()
            for _ in range(times):
                run()
            seconds[delays].append(time.process_time() - begin)
    rows: list[dict[str, object]] = []
    for delays, own in seconds.items():
        low, middle, high = np.quantile(np.array(own) / np.array(seconds[NONE]), [0.25, 0.5, 0.75]).tolist()
        rate = batch * STEPS * times / float(np.median(own))
        rows.append(
            {
                "batch": batch,
                "policy": "2 x 64 tanh" if policy else "given actions",
                "delays": delays,
                "agent_steps_per_cpu_s": rate,
                "time_to_none": middle,
                "time_to_none_low": low,
                "time_to_none_high": high,
            }
        )
    return rows


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batch", type=int, nargs="+", default=[64, 1024, 4096])
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--out", type=Path, help="CSV to write; must not be there")
    given = parser.parse_args(arguments)
    if given.out is not None and given.out.exists():
        parser.error(f"{given.out} exists; choose another name")
    torch.set_num_threads(1)
    rows = [
        row
        for batch in given.batch
        for policy in (True, False)
        for row in measure(batch, policy, given.repeats)
    ]
    for row in rows:
        print(
            f"{row['batch']:6} {row['policy']:14} {row['delays']:28} "
            f"{float(str(row['agent_steps_per_cpu_s'])) / 1e6:7.1f} M agent steps per CPU s, "
            f"{float(str(row['time_to_none'])):.2f} of the time without delays "
            f"[{float(str(row['time_to_none_low'])):.2f}, {float(str(row['time_to_none_high'])):.2f}]"
        )
    if given.out is not None:
        with whole_file(given.out) as partial:
            pd.DataFrame(rows).to_csv(partial, index=False)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
