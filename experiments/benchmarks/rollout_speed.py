"""Speed of rollouts on the delay graph, by executor and batch; with --peer against REX on the same work.

The work is that of `rollout_work.py`. With --peer both run in turn in one go, so that what else the machine does hits
both; with --peer-platform cuda, REX runs on the GPU. Medians and the spread between quartiles are printed, per second
of the clock and per second of processor time, which tells more where other things run. The executor "cuda" needs a
CUDA device, whose name is printed and written; processor time says nothing about it. To reach: 3 M agent steps/s at
B = 4096.
"""

import argparse
import csv
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepkoco.graph import BatchedRuntime, draw_timing
from deepkoco.graph.execution.runtime import EXECUTORS
from deepkoco.output.whole_file import whole_file
from experiments.benchmarks import rollout_work

STEPS = 200
SCHEDULES = 20
POPULATION, POPULATION_STEPS = 200, 1050
LEAST_SECONDS = 0.1  # of one measurement: shorter work is repeated
ROOT = Path(__file__).resolve().parents[2]
PEER = ROOT / ".venv-peers" / "bin" / "python"
PEER_SCRIPT = Path(__file__).parent / "peers" / "rex_rollout.py"


class OurWork:
    """The benchmark's graph in one executor.

    Args:
        executor: name of the executor.
        threads: of the fused one.
    """

    def __init__(self, executor: str, threads: int = 1) -> None:
        self.graph = rollout_work.make_graph()
        self.policy = rollout_work.make_policy()
        self.executor, self.threads = executor, threads
        self._runs: dict[tuple[str, int], Any] = {}
        self._runtimes: dict[str, BatchedRuntime] = {}

    def run(self, kind: str, batch: int, times: int = 1) -> tuple[float, float]:
        """Run "rollout" or "population" some times; return seconds of the clock and of the processor."""
        if (kind, batch) not in self._runs:
            self._runs[kind, batch] = self._prepare(kind, batch)
        begin, cpu = time.perf_counter(), time.process_time()
        for _ in range(times):
            self._runs[kind, batch]()
        if self.executor == "cuda":
            torch.cuda.synchronize()  # kernels are only queued when a call comes back
        return time.perf_counter() - begin, time.process_time() - cpu

    def _prepare(self, kind: str, batch: int) -> Any:
        steps, rows = (STEPS, SCHEDULES) if kind == "rollout" else (POPULATION_STEPS, 1)
        if kind not in self._runtimes:
            timing = draw_timing(self.graph, np.random.default_rng(0), steps, rows, rows=rows)
            self._runtimes[kind] = BatchedRuntime(
                self.graph, timing, executor=self.executor, threads=self.threads
            )
        runtime = self._runtimes[kind]
        parameters = rollout_work.make_parameters()
        if kind == "population":
            scale = torch.linspace(0.8, 1.2, batch)
            parameters["world"]["mass"] = parameters["world"]["mass"] * scale
            policy = torch.from_numpy(actions()).reshape(steps, 1, 1)
        else:
            policy = self.policy
        chosen = np.random.default_rng(1).integers(rows, size=batch)
        state, _ = runtime.reset(parameters, torch.Generator().manual_seed(0), rows=chosen)

        def run() -> None:
            with torch.no_grad():
                runtime.rollout(state, policy, steps, record=())

        return run

    def memory(self, batch: int) -> tuple[float, float]:
        """Bytes of an environment in the fused executor, and those of its own state in them."""
        self.run("rollout", batch)
        state, _ = self._runtimes["rollout"].reset(
            rollout_work.make_parameters(),
            torch.Generator().manual_seed(0),
            rows=np.zeros(batch, dtype=np.int64),
        )
        own = sum(v.numel() * v.element_size() for values in state.nodes.values() for v in values.values())
        fused: Any = state
        return fused.nbytes / batch, own / batch


class PeerWork:
    """The same in a process of the peer's Python.

    Args:
        python: its interpreter.
        platform: of JAX there, "cpu" or "cuda".
    """

    def __init__(self, python: Path = PEER, platform: str = "cpu") -> None:
        if not python.exists():
            raise SystemExit(f"{python} is not there; scripts/peers.sh installs the peers")
        with tempfile.NamedTemporaryFile("w", suffix=".json", delete=False) as file:
            json.dump(description(), file)
        environment = {k: v for k, v in os.environ.items() if k != "OMP_NUM_THREADS"}
        begin = time.perf_counter()
        self._process = subprocess.Popen(
            [str(python), str(PEER_SCRIPT), file.name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment | {"JAX_PLATFORMS": platform},
        )
        self._answer()
        self.import_seconds = time.perf_counter() - begin
        self.first: dict[tuple[str, int], dict[str, float]] = {}
        self.memory: dict[tuple[str, int], float] = {}

    def run(self, kind: str, batch: int, times: int = 1) -> tuple[float, float]:
        """Run "rollout" or "population" some times; return seconds of the clock and of the processor."""
        answer = self._ask({"do": kind, "batch": batch, "times": times})
        if answer["first"] is not None:
            self.first[kind, batch], self.memory[kind, batch] = answer["first"], answer["memory"]
        return answer["seconds"], answer["cpu"]

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write('{"do": "quit"}\n')
        self._process.stdin.close()
        self._process.wait(timeout=60)

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"the peer ended; run {PEER_SCRIPT} by hand to see why")
        return json.loads(line)


def actions() -> np.ndarray:
    """Voltages (steps,) of the population's episode, as one would record them for identification."""
    t = np.arange(POPULATION_STEPS) / rollout_work.AGENT_RATE
    return (1.5 * np.sin(2 * np.pi * 0.7 * t) + np.sin(2 * np.pi * 1.9 * t)).astype(np.float32)


def description() -> dict[str, Any]:
    """The work in plain numbers, for the peer."""
    layers = [m for m in rollout_work.make_policy() if isinstance(m, torch.nn.Linear)]
    laws = {"sensing": rollout_work.SENSING, "actuation": rollout_work.ACTUATION}
    world = rollout_work.make_parameters()["world"]
    names = (
        "inertia",
        "mass",
        "length",
        "viscous",
        "motor_constant",
        "resistance",
        "coulomb",
    )
    return {
        "steps": STEPS,
        "schedules": SCHEDULES,
        "population_steps": POPULATION_STEPS,
        "world_rate": rollout_work.WORLD_RATE,
        "agent_rate": rollout_work.AGENT_RATE,
        "window": rollout_work.WINDOW,
        **{name: [law.loc, law.scale] for name, law in laws.items()},
        "parameters": {name: float(world[name]) for name in names},
        "layers": [[m.weight.tolist(), m.bias.tolist()] for m in layers],
        "actions": actions()[:, None].tolist(),
    }


def start_up(executor: str, repeats: int = 3) -> dict[str, float]:
    """Seconds from the interpreter's start to the first step of a new graph, without and with a kernel kept.

    Of the clock and, as "..._cpu", of the processor; medians. "torch", "graph": until these are imported.
    """
    code = (
        "import numpy as np, torch; from deepkoco.graph import BatchedRuntime, draw_timing; "
        "from experiments.benchmarks import rollout_work as w; g = w.make_graph(); "
        "t = draw_timing(g, np.random.default_rng(0), 200, 20, rows=20); "
        f"r = BatchedRuntime(g, t, executor='{executor}'); "
        "s, _ = r.reset(w.make_parameters(), torch.Generator().manual_seed(0), rows=np.zeros(64, int)); "
        "r.step(s, torch.zeros(64, 1))"
    )
    with tempfile.TemporaryDirectory() as folder:
        work = {
            "torch": ("import torch", folder),
            "graph": ("import torch, deepkoco.graph", folder),
            "uncached": (code, ""),
            "cached": (code, folder),
        }
        timed(code, folder)
        taken = {
            name: [timed(program, cache) for _ in range(repeats)] for name, (program, cache) in work.items()
        }
    result = {}
    for name, pairs in taken.items():
        result[name], result[f"{name}_cpu"] = np.median(pairs, axis=0).tolist()
    return result


def timed(code: str, cache: str) -> tuple[float, float]:
    """Run a program with the kernels that are kept in a folder, "" for none; seconds of clock and processor."""
    with tempfile.TemporaryDirectory() as empty:
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        environment = os.environ | {"XDG_CACHE_HOME": cache or empty}
        subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, env=environment)
        seconds, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return seconds, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(workers: dict[str, Any], kind: str, batch: int, repeats: int, steps: int) -> list[dict[str, Any]]:
    """Run all in turn; agent steps per second of the clock and of the processor: median and quartiles."""
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in workers}
    times = {}
    for name, worker in workers.items():
        worker.run(kind, batch)
        times[name] = max(1, round(LEAST_SECONDS / worker.run(kind, batch)[0]))
    for _ in range(repeats):
        for name, worker in workers.items():
            taken[name].append(worker.run(kind, batch, times[name]))
    rows = []
    for name in workers:
        row: dict[str, Any] = {"work": kind, "batch": batch, "executor": name}
        for clock, column in (("s", 0), ("cpu_s", 1)):
            own = np.array([batch * steps * times[name] / pair[column] for pair in taken[name]])
            row |= _spread(f"steps_per_{clock}", own)
            if "rex" in workers and name != "rex":
                theirs = np.array([batch * steps * times["rex"] / pair[column] for pair in taken["rex"]])
                row |= _spread(f"ratio_to_rex_per_{clock}", own / theirs)
        rows.append(row)
    return rows


def _spread(name: str, values: np.ndarray) -> dict[str, float]:
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75]).tolist()
    return {name: middle, f"{name}_low": low, f"{name}_high": high}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batch", type=int, nargs="+", default=[1, 64, 1024, 16384])
    parser.add_argument("--executors", nargs="+", default=["eager", "fused"], choices=EXECUTORS)
    parser.add_argument("--threads", type=int, default=1, help="of the fused executor")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--peer", action="store_true", help="REX too, in turn with ours")
    parser.add_argument("--peer-python", type=Path, default=PEER, help="interpreter that has REX")
    parser.add_argument("--peer-platform", default="cpu", choices=("cpu", "cuda"), help="where REX runs")
    parser.add_argument("--start-up", action="store_true", help="time from the start to the first step")
    parser.add_argument("--population", action="store_true", help=f"{POPULATION} x {POPULATION_STEPS} steps")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--out", type=Path, help="CSV to write; must not be there")
    given = parser.parse_args(arguments)
    if given.out is not None and given.out.exists():
        parser.error(f"{given.out} exists; choose another name")
    if "cuda" in given.executors:
        try:
            BatchedRuntime(rollout_work.make_graph(), executor="cuda")
        except ValueError as error:
            parser.error(str(error))
    torch.set_num_threads(1)
    workers: dict[str, Any] = {name: OurWork(name, given.threads) for name in given.executors}
    peer = PeerWork(given.peer_python, given.peer_platform) if given.peer else None
    if peer is not None:
        workers["rex"] = peer
    rows = []
    for batch in given.batch:
        # A rollout of the eager executor takes seconds whatever the batch; at large ones it adds nothing.
        able = {name: w for name, w in workers.items() if name != "eager" or batch <= 1024}
        repeats = 2 if "eager" in able and batch > 64 else given.repeats
        rows += measure(able, "rollout", batch, repeats, STEPS)
    if given.population:
        able = {name: worker for name, worker in workers.items() if name != "eager"}
        rows += measure(able, "population", POPULATION, given.repeats, POPULATION_STEPS)
    result: dict[str, Any] = {"rows": rows}
    if "cuda" in workers:
        result["device"] = torch.cuda.get_device_name()
        for row in rows:
            on_device = row["executor"] == "cuda" or (
                row["executor"] == "rex" and given.peer_platform == "cuda"
            )
            row |= {"device": result["device"]} if on_device else {}
    if "fused" in workers:
        every, own = workers["fused"].memory(1024)
        result["bytes_per_environment"] = {"fused": every, "own_state": own}
    if peer is not None:
        result.setdefault("bytes_per_environment", {})["rex"] = next(iter(peer.memory.values()))
        result["rex_start_up"] = {"import": peer.import_seconds, **next(iter(peer.first.values()))}
        peer.close()
    if given.start_up:
        result["start_up"] = start_up("fused")
    if given.out is not None:
        write_csv(given.out, rows)
    sys.stdout.write(json.dumps(result) + "\n" if given.json else table(result))
    return 0


def table(result: dict[str, Any]) -> str:
    """What was measured, for people: medians with quartiles."""
    lines = [
        f"{'work':10s} {'batch':>6s} {'executor':8s} {'steps per s':>32s} {'steps per CPU s':>32s}  to REX per CPU s"
    ]
    for row in result["rows"]:
        rates = []
        for name in ("steps_per_s", "steps_per_cpu_s"):
            quartiles = f"[{row[f'{name}_low']:.0f}, {row[f'{name}_high']:.0f}]"
            rates.append(f"{row[name]:10.0f} {quartiles:>21s}")
        ratio = row.get("ratio_to_rex_per_cpu_s")
        ratios = "" if ratio is None else f"  {ratio:.2f} x"
        lines.append(f"{row['work']:10s} {row['batch']:6d} {row['executor']:8s} {' '.join(rates)}{ratios}")
    for title, unit, key in (
        ("memory of an environment", "B", "bytes_per_environment"),
        ("from the start to the first step", "s", "start_up"),
        ("REX, from the start to the first step", "s", "rex_start_up"),
    ):
        if key in result:
            numbers = ", ".join(
                f"{name} {value:.4g}{'' if name == 'slots' else ' ' + unit}"
                for name, value in result[key].items()
            )
            lines.append(f"{title}: {numbers}")
    if "device" in result:
        lines.append(f"device: {result['device']}")
    return "\n".join(lines) + "\n"


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write the rows, whole or not at all."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with whole_file(path) as partial, partial.open("w", newline="") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    raise SystemExit(main())
