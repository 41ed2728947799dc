"""Steps of one environment per CPU second: `python -m experiments.benchmarks.single_environment [--peer] [--json]`.

Ours with and without delay, Gymnasium's Pendulum-v1 and, with --peer, EAGERx's pendulum with a sensing delay
take turns in one run, each through `gymnasium`-style `reset` and `step` with a constant action, resets included.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import deepkoco.envs  # noqa: F401 - registers the environments
from experiments.plumbing.provenance import provenance

GYMNASIUM = "gymnasium Pendulum-v1"
EAGERX = "eagerx pendulum, 20 ms sensing delay"
OURS = {
    "deepkoco RodPendulum-v0": ("deepkoco/RodPendulum-v0", {}),
    "deepkoco RodPendulumDelay-v0": ("deepkoco/RodPendulumDelay-v0", {}),
    "deepkoco RodPendulum-v0, random delays": (
        "deepkoco/RodPendulum-v0",
        {
            "actuation_delay": {"law": "gaussian", "loc": 0.03, "scale": 0.01},
            "sensing_delay": {"law": "gaussian", "loc": 0.02, "scale": 0.005},
        },
    ),
}
EAGERX_PYTHON = Path(__file__).resolve().parents[2] / ".venv-eagerx/bin/python"

Take = Callable[[int], float]
"""Takes steps and returns the CPU seconds that they took."""


def gymnasium_steps(name: str, options: dict[str, Any]) -> Take:
    """A Gymnasium environment that starts an episode anew whenever one ends."""
    environment = gymnasium.make(name, **options)
    environment.reset(seed=0)
    action = np.full(environment.action_space.shape or (1,), 0.3, np.float32)

    def take(steps: int) -> float:
        environment.reset()
        start = time.process_time()
        for _ in range(steps):
            *_, terminated, truncated, _ = environment.step(action)
            if terminated or truncated:
                environment.reset()
        return time.process_time() - start

    take(50)
    return take


def eagerx_steps(python: Path, steps: int) -> Take:
    """EAGERx's pendulum in a process of its own."""
    script = Path(__file__).parent / "peers" / "eagerx_pendulum.py"
    process = subprocess.Popen(
        [str(python), str(script), str(steps)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )

    def take(_: int) -> float:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write("\n")
        process.stdin.flush()
        for line in process.stdout:
            if line.startswith("RESULT "):
                return json.loads(line.removeprefix("RESULT "))["cpu_s"]
        raise SystemExit(f"{python} {script} ended without a result; run it by hand to see why")

    return take


def measure(contestants: dict[str, Take], steps: int, repeats: int) -> dict[str, list[float]]:
    """Steps per CPU second of each contestant in each of the interleaved repeats."""
    rates: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(repeats):
        for name, take in contestants.items():
            rates[name].append(steps / take(steps))
    return rates


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.benchmarks.single_environment", description=__doc__
    )
    parser.add_argument("--steps", type=int, default=1000, help="steps of one measurement")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument(
        "--peer", action="store_true", help="measure EAGERx too (scripts/peers.sh installs it)"
    )
    parser.add_argument("--eagerx-python", type=Path, default=EAGERX_PYTHON)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--out", type=Path, help="CSV of every measurement; must not exist")
    options = parser.parse_args(arguments)
    if options.peer and not options.eagerx_python.exists():
        parser.error(f"{options.eagerx_python}: no such interpreter; run scripts/peers.sh")
    if options.out is not None and options.out.exists():
        parser.error(f"{options.out}: exists; choose another name")
    contestants = {name: gymnasium_steps(*made) for name, made in OURS.items()}
    contestants[GYMNASIUM] = gymnasium_steps("Pendulum-v1", {})
    if options.peer:
        contestants[EAGERX] = eagerx_steps(options.eagerx_python, options.steps)
    rates = measure(contestants, options.steps, options.repeats)
    peers = [name for name in (GYMNASIUM, EAGERX) if name in rates]
    summary = {
        name: {
            "steps_per_cpu_s": statistics.median(values),
            "lowest": min(values),
            "highest": max(values),
            # The ratio is taken within each repeat, so that a disturbance of the machine hits both sides.
            "ratio": {
                peer: statistics.median(a / b for a, b in zip(values, rates[peer], strict=True))
                for peer in peers
            },
        }
        for name, values in rates.items()
    }
    if options.out is not None:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        lines = ["environment,repeat,steps_per_cpu_s"]
        lines += [
            f'"{name}",{i},{value!r}' for name, values in rates.items() for i, value in enumerate(values)
        ]
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    if options.json:
        json.dump({"results": summary, "provenance": provenance()}, sys.stdout, indent=1)
        print()
        return
    for name, result in summary.items():
        ratios = ", ".join(f"{ratio:.2f} x {peer}" for peer, ratio in result["ratio"].items() if peer != name)
        spread = f"[{result['lowest']:.0f}, {result['highest']:.0f}]"
        print(f"{name:42s} {result['steps_per_cpu_s']:8.0f} steps per CPU s {spread}  {ratios}")


if __name__ == "__main__":
    main()
