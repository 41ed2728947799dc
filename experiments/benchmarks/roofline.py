"""How much of the machine a kernel uses: `python -m experiments.benchmarks.roofline [--out roofline.csv]`.

A loop written by hand takes Runge-Kutta steps of the benchmark's pendulum and does nothing else: no graph, no delays,
no messages, the states in registers, the number of vectors side by side that is fastest. The same vector functions and
the same compiler as in a kernel. It and the population of `rollout_work.py` (no policy, 200 x 1050 steps) take turns in
one run, so that what else the machine does hits both; the highest rate of each counts. An agent step has two
Runge-Kutta steps. Without the dry friction (a hyperbolic tangent per derivative) the loop shows what the machine does
with a sine alone.
"""

import argparse
import ctypes
import time
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from deepkoco.graph.execution.fused.compiler import load
from deepkoco.graph.execution.fused.lowered import header_text
from deepkoco.output.whole_file import whole_file
from experiments.benchmarks import rollout_work
from experiments.benchmarks.rollout_speed import POPULATION, POPULATION_STEPS, OurWork

LANES = 16
UNITS = (1, 2, 3, 4, 6)
STEPS = 20_000
SUBSTEPS = rollout_work.WORLD_RATE // rollout_work.AGENT_RATE


class Roofline:
    """The loop by hand as machine code."""

    def __init__(self) -> None:
        text = Path(__file__).with_suffix(".cpp").read_text()
        source = "\n".join([f"#define W {LANES}", header_text("lanes.h"), header_text("functions.h"), text])
        self._run = load(source).roofline
        world = {name: float(value) for name, value in rollout_work.make_parameters()["world"].items()}
        self._parameters = np.array(
            [
                world["motor_constant"],
                1 / world["resistance"],
                world["mass"] * 9.81 * world["length"],
                world["viscous"],
                world["coulomb"],
                1 / world["inertia"],
                1.5,  # [V]
            ],
            np.float32,
        )

    def run(self, units: int, friction: bool, steps: int) -> tuple[np.ndarray, float]:
        """Take Runge-Kutta steps of units x LANES pendulums.

        Returns:
            Angles and speeds (units, 2, LANES), and CPU seconds.

        Raises:
            RuntimeError: there is no loop over this number of vectors.
        """
        states = np.zeros((units, 2, LANES), np.float32)
        states[:, 0] = np.linspace(-3, 3, units * LANES).reshape(units, LANES)
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (self._parameters, states)]
        begin = time.process_time()
        done = self._run(pointers[0], int(friction), units, ctypes.c_int64(steps), pointers[1])
        seconds = time.process_time() - begin
        if not done:
            raise RuntimeError(f"no loop over {units} vectors")
        return states, seconds


def measure(repeats: int) -> list[dict[str, object]]:
    """Rates of the loops and of the kernel, in turns: agent steps per CPU second, the highest of the repeats."""
    torch.set_num_threads(1)
    loop, ours = Roofline(), OurWork("fused")
    ours.run("population", POPULATION)
    best: dict[tuple[str, int], float] = {}
    for _ in range(repeats):
        for friction in (True, False):
            for units in UNITS:
                _, seconds = loop.run(units, friction, STEPS)
                key = ("by hand" if friction else "by hand, no friction"), units
                rate = units * LANES * STEPS / SUBSTEPS / seconds
                best[key] = max(best.get(key, 0.0), rate)
        times = 5
        seconds = ours.run("population", POPULATION, times)[1]
        rate = POPULATION * POPULATION_STEPS * times / seconds
        best["kernel", 0] = max(best.get(("kernel", 0), 0.0), rate)
    kernel = best["kernel", 0]
    rows: list[dict[str, object]] = []
    for name in ("by hand", "by hand, no friction"):
        rate, units = max((value, units) for (own, units), value in best.items() if own == name)
        rows.append(
            {
                "work": name,
                "vectors": units,
                "agent_steps_per_cpu_s": rate,
                "runge_kutta_steps_per_cpu_s": rate * SUBSTEPS,
                "kernel_of_it": kernel / rate,
            }
        )
    rows.append(
        {
            "work": "kernel",
            "vectors": "",
            "agent_steps_per_cpu_s": kernel,
            "runge_kutta_steps_per_cpu_s": kernel * SUBSTEPS,
            "kernel_of_it": 1.0,
        }
    )
    return rows


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--out", type=Path, help="CSV to write; must not be there")
    given = parser.parse_args(arguments)
    if given.out is not None and given.out.exists():
        parser.error(f"{given.out} exists; choose another name")
    rows = measure(given.repeats)
    for row in rows:
        print(
            f"{row['work']:22s} {float(str(row['agent_steps_per_cpu_s'])) / 1e6:7.0f} M agent steps, "
            f"{float(str(row['runge_kutta_steps_per_cpu_s'])) / 1e6:7.0f} M Runge-Kutta steps per CPU s; "
            f"the kernel reaches {100 * float(str(row['kernel_of_it'])):.0f} % of it"
        )
    if given.out is not None:
        with whole_file(given.out) as partial:
            pd.DataFrame(rows).to_csv(partial, index=False)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
