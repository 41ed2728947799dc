"""Simulations along logs by bytecode, against the same steps in torch: processor seconds and their ratio, in one run.

python -m experiments.benchmarks.bytecode_speed [--systems rod_pendulum two_link_arm] [--lanes 40] [--times 3]

Each row simulates 20 windows of 200 steps in as many lanes as are asked for, under drawn parameters and commands. The
first simulation of a system traces its equations; that takes the seconds of the column "trace" and is done once.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.simulate.bytecode.along_windows import along_windows
from deepkoco.fit.simulate.equations import equations_of
from deepkoco.fit.simulate.nodes import Nodes
from deepkoco.fit.simulate.torch_steps import StepsInput, in_torch
from deepkoco.systems import ExtendedSystem, make_system, system_names
from deepkoco.systems.effects import effects_of

WINDOWS, STEPS, STEP = 20, 200, 0.002
FRICTIONS = ("coulomb", "stribeck", "bristle")


def main(arguments: Sequence[str] | None = None, write: Callable[[str], object] = sys.stdout.write) -> None:
    """Print a row for each system, without effects and with three kinds of dry friction at each joint."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--systems", nargs="+", choices=system_names(), default=list(system_names()))
    parser.add_argument("--lanes", type=int, default=40, help="sets of parameters (default 40)")
    parser.add_argument("--times", type=int, default=3, help="how often each is timed; the least counts")
    args = parser.parse_args(arguments)
    write("| system | effects | trace [s] | bytecode [s] | torch [s] | ratio |\n|---|---|---|---|---|---|\n")
    for name in args.systems:
        base = make_system(name)
        frictions = [n for n in effects_of(base) if n.startswith(FRICTIONS)]
        for effects in ([], frictions):
            system = ExtendedSystem(base, tuple(effects))
            values, given = _drawn(system, args.lanes)
            first = _seconds(lambda s=system, v=values, g=given: along_windows(s, v, None, g))
            found = along_windows(system, values, None, given)
            if found is None:
                write(f"| {name} | {len(effects)} | {first:.2f} | no trace | | |\n")
                continue
            fast, slow = (
                min(_seconds(call) for _ in range(args.times))
                for call in (
                    lambda s=system, v=values, g=given: along_windows(s, v, None, g),
                    lambda s=system, v=values, g=given: in_torch(equations_of(s, v, None), g),
                )
            )
            write(
                f"| {name} | {len(effects)} | {first - fast:.2f} | {fast:.3f} | {slow:.3f} | {slow / fast:.1f} |\n"
            )


def _drawn(system: ExtendedSystem, lanes: int) -> tuple[dict[str, Tensor], StepsInput]:
    """Values of parameters within their priors, and starts and commands."""
    rng = np.random.default_rng(0)
    values = {
        p.name: torch.from_numpy(np.clip(p.value + p.prior_sd * rng.uniform(0.0, 1.0, lanes), p.low, p.high))
        for p in system.parameters
    }
    shape = (WINDOWS, lanes)
    start = [torch.from_numpy(0.3 * rng.standard_normal(shape)) for _ in range(2 * system.joints)]
    begin = [
        torch.from_numpy(min(abs(c.high), 2.0) * rng.uniform(-1.0, 1.0, (STEPS, *shape)))
        for c in system.commands
    ]
    time0 = torch.zeros(WINDOWS, 1, dtype=torch.float64)
    return values, StepsInput(STEP, start, time0, begin, [torch.zeros_like(b) for b in begin], None)


def _seconds(call: Callable[[], Nodes | None]) -> float:
    began = time.process_time()
    call()
    return time.process_time() - began


if __name__ == "__main__":
    main()
