"""A pendulum identified by populations in REX and here: same replay, same candidates, then each its own search.

python -m experiments.benchmarks.identify_peer [--repeats 7] [--threads 1] [--out results/identify/peer] [--json]

The construction is that of the published fit: CMA-ES with 200 points, 38 generations, 1050 steps (21 s at 50 Hz) of a
pendulum whose world runs at 100 Hz, with delayed measurements and commands, single precision. First the cost of the
same 38 generations of candidates is computed by both: the costs must agree, so that the work is the same, and their
times compare the replay alone. Then each fits from the same start with its own CMA-ES: the package `cma` here,
evosax's in REX, where the whole search is one compiled function. Both run in turn in one go; compilation is timed
apart. `scripts/peers.sh` installs the peer into an environment of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from deepkoco.fit import GraphMisfit, fit_graph, seen_by_supervisor
from deepkoco.fit.threads import one_thread
from deepkoco.graph import (
    BatchedRuntime,
    Connection,
    Deterministic,
    Episode,
    Graph,
    Input,
    draw_timing,
    record_episodes,
)
from deepkoco.graph.model.node import Parameters, State
from experiments.benchmarks import rollout_work
from experiments.benchmarks.rollout_speed import PEER, actions
from experiments.plumbing.provenance import as_markdown

PEER_SCRIPT = Path(__file__).parent / "peers" / "rex_fit.py"
POPULATION, GENERATIONS = 200, 38
SENSING, ACTUATION = 0.0123, 0.0081  # [s]; no message arrives at the very instant at which a step starts
INITIAL = (2.8, 0.0)  # angle [rad] and speed [rad/s] at the start: near hanging
NOISE_SD = (0.002, 0.05)  # of angle [rad] and speed [rad/s]
SOUGHT = ("mass", "viscous", "motor_constant", "coulomb")
TRUE = {"mass": 1.08, "viscous": 1.2, "motor_constant": 0.94, "coulomb": 1.15}  # over nominal
PHYSICS = ("inertia", "mass", "length", "viscous", "motor_constant", "resistance", "coulomb")
REACH = 0.5  # bounds: nominal values less and more this part of them


class FixedWorld(rollout_work.PendulumWorld):
    """The pendulum from a known state."""

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"state": torch.tensor(INITIAL, dtype=torch.float32).expand(batch, 2).clone()}


class Watcher(rollout_work.PendulumAgent):
    """Shows the newest measurement as it is."""

    def observe(
        self, parameters: Parameters, state: State, inputs: Mapping[str, Input], action: torch.Tensor
    ) -> tuple[State, dict[str, torch.Tensor]]:
        newest = inputs["sensor"].data[:, -1]
        return state, {"angle": newest[:, :1], "speed": newest[:, 1:]}


def make_graph() -> Graph:
    """World, sensor, actuator and agent with constant delays."""
    return Graph(
        [
            FixedWorld(),
            rollout_work.Relay("sensor", 2),
            Watcher("agent", rollout_work.AGENT_RATE, initial_action=torch.zeros(1)),
            rollout_work.Relay("actuator", 1),
        ],
        [
            Connection("world", "sensor"),
            Connection("sensor", "agent", Deterministic(SENSING)),
            Connection("agent", "actuator", Deterministic(ACTUATION)),
            Connection("actuator", "world", skip=True),
        ],
    )


class Ours:
    """The fit on the delay graph."""

    def __init__(self, threads: int) -> None:
        self.graph, self.compiled = make_graph(), set[str]()
        self.nominal = rollout_work.make_parameters()
        true = {n: v * TRUE.get(n, 1.0) for n, v in self.nominal["world"].items()}
        voltage = actions()
        timing = draw_timing(self.graph, np.random.default_rng(0), len(voltage), 1)
        given = iter(torch.from_numpy(voltage).reshape(-1, 1, 1))
        runtime = BatchedRuntime(self.graph, timing)
        episodes, _ = record_episodes(
            runtime, lambda _: next(given), {"world": true}, torch.Generator().manual_seed(0)
        )
        self.episode = episodes[0]
        seen = seen_by_supervisor(self.graph, self.episode, "sensor->agent")
        noise = np.random.default_rng(1).standard_normal(seen.shape)
        self.measured = seen + np.array(NOISE_SD) * noise
        centre = np.array([float(self.nominal["world"][n]) for n in SOUGHT])
        self.low, self.high = (1.0 - REACH) * centre, (1.0 + REACH) * centre
        self.true = np.array([float(true[n]) for n in SOUGHT])

        self.asked: dict[str, Any] = {
            "graph": self.graph,
            "episode": self.episode,
            "parameters": self.nominal,
            "sought": {f"world.{n}": (a, b) for n, a, b in zip(SOUGHT, self.low, self.high, strict=True)},
            "measured": {"angle": self.measured[:, :1], "speed": self.measured[:, 1:]},
            "noise_sd": dict(zip(("angle", "speed"), NOISE_SD, strict=True)),
            "threads": threads,
        }

        self.misfit = GraphMisfit(**self.asked)

    def costs(self, generations: np.ndarray) -> dict[str, Any]:
        """Costs of generations (G, L, p)."""
        return {"costs": [self.misfit.costs(points).tolist() for points in generations]}

    def fit(self, seed: int) -> dict[str, Any]:
        """A search of its own."""
        found = fit_graph(population=POPULATION, generations=GENERATIONS, seed=seed, **self.asked)
        return {"best": found.search.best.tolist(), "cost": found.search.cost}

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """Do what the peer is asked too, and say how long it took; `first` is the time of the very first call."""
        work: dict[str, Callable[[], dict]] = {
            "costs": lambda: self.costs(np.array(request["generations"])),
            "fit": lambda: self.fit(request["seed"]),
        }
        first = None
        if request["do"] not in self.compiled:
            self.compiled.add(request["do"])
            begin = time.perf_counter()
            work[request["do"]]()
            first = time.perf_counter() - begin
        begin, cpu = time.perf_counter(), time.process_time()
        result = work[request["do"]]()
        seconds, cpu = time.perf_counter() - begin, time.process_time() - cpu
        return {**result, "seconds": seconds, "cpu": cpu, "first": first}


class Peer:
    """REX in a process of its own Python."""

    def __init__(self, ours: Ours) -> None:
        if not PEER.exists():
            raise SystemExit(f"{PEER} is not there; scripts/peers.sh installs the peers")
        steps = len(actions())
        # What the supervisor sees at its first step was not measured; what it sees after its last command was.
        reading, weight = np.zeros((steps + 1, 2)), np.zeros((steps + 1, 2))
        reading[1:], weight[1:] = ours.measured, 1.0 / np.array(NOISE_SD)
        command = np.append(actions(), 0.0)[:, None]
        work = {
            "steps": steps,
            "world_rate": rollout_work.WORLD_RATE,
            "agent_rate": rollout_work.AGENT_RATE,
            **computation_graph(ours.episode),
            "initial": INITIAL,
            "parameters": {n: float(ours.nominal["world"][n]) for n in PHYSICS},
            "command": command.tolist(),
            "reading": reading.tolist(),
            "weight": weight.tolist(),
            "sought": SOUGHT,
            "low": ours.low.tolist(),
            "high": ours.high.tolist(),
            "start": [0.0] * len(SOUGHT),  # the middle of the bounds
            "population": POPULATION,
            "generations": GENERATIONS,
        }
        with tempfile.NamedTemporaryFile("w", suffix=".json", delete=False) as file:
            json.dump(work, file)
        environment = {k: v for k, v in os.environ.items() if k != "OMP_NUM_THREADS"}
        self.process = subprocess.Popen(
            [str(PEER), str(PEER_SCRIPT), file.name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment | {"JAX_PLATFORMS": "cpu"},
        )
        self.answer()

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """Send a request and wait for its answer."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        return self.answer()

    def answer(self) -> dict[str, Any]:
        """Next line of the peer."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"the peer ended; run {PEER_SCRIPT} by hand to see why")
        return json.loads(line)

    def close(self) -> None:
        """End the process."""
        assert self.process.stdin is not None
        self.process.stdin.write('{"do": "quit"}\n')
        self.process.stdin.close()
        self.process.wait(timeout=60)


def computation_graph(episode: Episode) -> dict[str, Any]:
    """When each step ran, and at which step of its receiver each message was taken, -1 for never."""
    measured, vertices, edges = episode.measured, {}, []
    for name, start in measured.t_start.items():
        # The supervisor's last step only starts.
        end = np.append(measured.t_end[name], start[len(measured.t_end[name]) :])[: len(start)]
        vertices[name] = (start.tolist(), end.tolist())
    for key, window in episode.windows.items():
        sender, receiver = key.split("->")
        arrived = measured.t_received[key]
        taken = np.searchsorted(window[:, -1], np.arange(len(arrived)))
        edges.append((sender, receiver, np.where(taken < len(window), taken, -1).tolist(), arrived.tolist()))
    return {"vertices": vertices, "edges": edges}


def candidates(ours: Ours, seed: int) -> np.ndarray:
    """Generations (G, L, p) that close in on the true values as a search's do, in single precision."""
    rng = np.random.default_rng(seed)
    shrink = np.geomspace(0.5, 0.005, GENERATIONS)[:, None, None]
    centre = 0.5 * (ours.low + ours.high)
    middle = ours.true + (centre - ours.true) * shrink
    spread = shrink * (ours.high - ours.low) * rng.standard_normal((GENERATIONS, POPULATION, len(SOUGHT)))
    return np.clip(middle + spread, ours.low, ours.high).astype(np.float32).astype(np.float64)


def compare(ours: Ours, peer: Peer, repeats: int) -> tuple[pd.DataFrame, dict[str, float]]:
    """Both in turn; one row a measurement, and how far the costs of the same candidates are apart."""
    workers = {"deepkoco": ours, "rex": peer}
    rows, apart = [], {}
    for repeat in range(repeats):
        points = candidates(ours, repeat)
        taken = {}
        for name, worker in workers.items():
            taken[name] = worker.ask({"do": "costs", "generations": points.tolist()})
            rows.append(_row("same candidates", repeat, name, taken[name], {}))
        if not apart:
            both = [np.array(taken[name]["costs"]) for name in workers]
            apart = agreement(*both)
        for name, worker in workers.items():
            found = worker.ask({"do": "fit", "seed": repeat})
            error = float(np.abs(np.array(found["best"]) / ours.true - 1.0).max())
            rows.append(
                _row("own search", repeat, name, found, {"cost": found["cost"], "largest_error": error})
            )
    return pd.DataFrame(rows), apart


def _row(work: str, repeat: int, name: str, answer: dict[str, Any], more: dict[str, float]) -> dict[str, Any]:
    row = {
        "work": work,
        "repeat": repeat,
        "package": name,
        "seconds": answer["seconds"],
        "cpu_s": answer["cpu"],
    }
    return {**row, "first_s": answer["first"], **more}


def agreement(ours: np.ndarray, theirs: np.ndarray) -> dict[str, float]:
    """How far two sets of costs are apart, relative to their mean."""
    relative = np.abs(ours - theirs) / (0.5 * (np.abs(ours) + np.abs(theirs)))
    return {"median": float(np.median(relative)), "99 %": float(np.quantile(relative, 0.99))}


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Median and quartiles by work and package, and of REX over ours, pair by pair."""
    rows = []
    for work, own in table.groupby("work", sort=False):
        pairs = {
            clock: own.pivot(index="repeat", columns="package", values=clock)
            for clock in ("seconds", "cpu_s")
        }
        for name, mine in own.groupby("package", sort=False):
            row: dict[str, Any] = {"work": work, "package": name}
            for clock, pair in pairs.items():
                row |= _spread(clock, mine[clock].to_numpy(dtype=float))
                row |= _spread(f"{clock}_rex_over_this", (pair["rex"] / pair[name]).to_numpy(dtype=float))
            row["first_s"] = float(np.nanmax(mine["first_s"].to_numpy(dtype=float)))
            row["steps_per_s"] = POPULATION * GENERATIONS * len(actions()) / row["seconds"]
            error = mine["largest_error"].to_numpy(dtype=float)
            if np.isfinite(error).any():
                row["largest_error_median"] = float(np.median(error))
            rows.append(row)
    return pd.DataFrame(rows)


def _spread(name: str, values: np.ndarray) -> dict[str, float]:
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75]).tolist()
    return {name: middle, f"{name}_low": low, f"{name}_high": high}


def main(arguments: list[str] | None = None) -> int:
    """Run the comparison and write its table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--threads", type=int, default=1, help="of our executor; REX takes all cores")
    parser.add_argument(
        "--out", type=Path, help="new folder for measurements.csv, summary.csv and provenance.md"
    )
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    if args.repeats < 1 or args.threads < 1:
        parser.error("give at least one repeat and one thread")
    if args.out is not None and args.out.exists():
        parser.error(f"{args.out} exists; choose another name")
    with one_thread():
        ours = Ours(args.threads)
        peer = Peer(ours)
        table, apart = compare(ours, peer, args.repeats)
        peer.close()
    short = summary(table)
    if args.out is not None:
        args.out.mkdir(parents=True)
        table.to_csv(args.out / "measurements.csv", index=False, float_format="%.6g", lineterminator="\n")
        short.to_csv(args.out / "summary.csv", index=False, float_format="%.4g", lineterminator="\n")
        (args.out / "provenance.md").write_text(as_markdown() + "\n", encoding="utf-8")
    result = {"costs_apart": apart, "rows": short.to_dict("records")}
    sys.stdout.write(
        json.dumps(result, indent=2) + "\n"
        if args.json
        else f"{short.to_string(index=False)}\ncosts of the same candidates apart by {apart}\n"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
