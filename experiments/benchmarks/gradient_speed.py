"""Time of a gradient of a rollout, in shares of the time of the rollout; with --peer and --compile against others.

python -m experiments.benchmarks.gradient_speed [--batch 1 64 256 1024] [--peer] [--compile] [--out FILE]

The work is that of `gradient_work.py`: 50 agent steps (--steps), the gradient by all parameters, the start and all
actions. All take turns, so that what else the machine does hits all; medians and quartiles over the repeats.

"kernel" is the part of the processor time that the compiled kernels take; the rest is Python and torch.

forward: the fused rollout without gradients, from a state that is there. gradient: the same with its gradient.
actions: only by the actions. reset: gradient, with a new reset each time. eager: gradient in the eager executor.
differences_P: forward differences by P unknowns of each environment, as more environments of one batch.
rex: the peer on the same graph. scan, compiled: a loop in JAX written by hand, and one step of torch.compile in a loop,
both without delays and without a graph.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph import BatchedRuntime, draw_timing
from deepkoco.systems import rk4_step
from experiments.benchmarks import gradient_work, rollout_speed
from experiments.benchmarks.rollout_work import WORLD_RATE

SCHEDULES = 20
LEAST_SECONDS = 0.1
SLOW = ("eager", "compiled")
PEER_SCRIPT = Path(__file__).parent / "peers" / "rex_gradient.py"


class Watched:
    """A function of a kernel, with the processor time that it has taken."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self.seconds = function, 0.0

    def __call__(self, *arguments: Any) -> Any:
        begin = time.process_time()
        result = self.function(*arguments)
        self.seconds += time.process_time() - begin
        return result


class Ours:
    """One world in one executor.

    Args:
        world: its name.
        executor: "fused" or "eager".
        batch: environments.
        steps: of the agent.
        threads: of the fused one.
        schedules: different timings that the environments have.
    """

    def __init__(
        self,
        world: str,
        executor: str,
        batch: int,
        steps: int = 50,
        threads: int = 1,
        schedules: int = SCHEDULES,
    ) -> None:
        node, values, width, size = gradient_work.make_world(world)
        graph = gradient_work.make_graph(node, width, size)
        timing = draw_timing(graph, np.random.default_rng(0), steps, schedules, rows=schedules)
        self.runtime = BatchedRuntime(graph, timing, executor=executor, threads=threads)
        self.parameters = {key: value.clone().requires_grad_() for key, value in values.items()}
        self.actions = gradient_work.make_actions(steps, batch, width).requires_grad_()
        random = torch.Generator().manual_seed(0)
        self.start = (0.5 * torch.randn(batch, size, generator=random)).requires_grad_()
        self._watched: list[Watched] = []
        self.rows = np.random.default_rng(1).integers(schedules, size=batch)

    def kernel_seconds(self) -> float:
        """Processor time in kernels so far; begins to count when it is first called."""
        executor: Any = self.runtime._executor
        for kernel in getattr(executor, "_kernels", {}).values():
            for name in ("rollout", "record", "reverse"):
                function = getattr(kernel, name, None)
                if function is not None and not isinstance(function, Watched):
                    setattr(kernel, name, Watched(function))
                    self._watched.append(getattr(kernel, name))
        return sum(watched.seconds for watched in self._watched)

    def reset(self) -> Any:
        start = {"world": {"state": self.start}}
        return self.runtime.reset(
            {"world": self.parameters}, torch.Generator().manual_seed(0), start, rows=self.rows
        )[0]

    def forward(self) -> Callable[[], Any]:
        """What a rollout without gradients does, from a state that is there."""
        with torch.no_grad():
            state = self.reset()

        @torch.no_grad()
        def run() -> Tensor:
            return (
                self.runtime.rollout(state, self.actions, record=())[0].nodes["world"]["state"].square().sum()
            )

        return run

    def gradient(self) -> Callable[[], Any]:
        """The gradient by parameters, start and actions, from a state that is there."""
        wanted, state = [*self.parameters.values(), self.start, self.actions], self.reset()

        def run() -> tuple[Tensor, ...]:
            after, _ = self.runtime.rollout(state, self.actions, record=())
            loss = after.nodes["world"]["state"].square().sum()
            return torch.autograd.grad(loss, wanted, retain_graph=True)  # of the reset

        return run

    def by_actions(self) -> Callable[[], Any]:
        """The gradient by the actions alone, as a planner wants it."""
        with torch.no_grad():
            state = self.reset()
        for value in self.parameters.values():
            value.requires_grad_(False)

        def run() -> tuple[Tensor, ...]:
            after, _ = self.runtime.rollout(state, self.actions, record=())
            return torch.autograd.grad(after.nodes["world"]["state"].square().sum(), self.actions)

        return run

    def with_reset(self) -> Callable[[], Any]:
        """The gradient by parameters, start and actions, after a reset of its own."""
        wanted = [*self.parameters.values(), self.start, self.actions]

        def run() -> tuple[Tensor, ...]:
            after, _ = self.runtime.rollout(self.reset(), self.actions, record=())
            return torch.autograd.grad(after.nodes["world"]["state"].square().sum(), wanted)

        return run


OURS = {
    "forward": Ours.forward,
    "gradient": Ours.gradient,
    "actions": Ours.by_actions,
    "reset": Ours.with_reset,
}


def compiled(batch: int, steps: int) -> Callable[[], Any]:
    """The pendulum by torch.compile: two ticks of the world in one function, in a loop over the actions."""
    node, values, width, size = gradient_work.make_world("pendulum")
    world: Any = node
    parameters = {key: value.clone().requires_grad_() for key, value in values.items()}
    actions = gradient_work.make_actions(steps, batch, width).requires_grad_()
    start = (0.5 * torch.randn(batch, size, generator=torch.Generator().manual_seed(0))).requires_grad_()

    @torch.compile(dynamic=False)
    def step(x: Tensor, effort: Tensor, parameters: dict[str, Tensor]) -> Tensor:
        for _ in range(2):
            x = rk4_step(world.system, x, effort, 1 / WORLD_RATE, parameters)
        return x

    def run() -> tuple[Tensor, ...]:
        x = start
        for action in actions:
            x = step(x, action[:, 0], parameters)
        return torch.autograd.grad(x.square().sum(), [*parameters.values(), start, actions])

    return run


class Peer:
    """JAX in a process of the peers' Python.

    Args:
        steps: of the agent.
    """

    def __init__(self, steps: int) -> None:
        work = rollout_speed.description() | {
            "steps": steps,
            "schedules": SCHEDULES,
            "actions": gradient_work.make_actions(steps, 1, 1)[:, 0].tolist(),
        }
        with tempfile.NamedTemporaryFile("w", suffix=".json", delete=False) as file:
            json.dump(work, file)
        command = [str(rollout_speed.PEER), str(PEER_SCRIPT), file.name]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self._answer()

    def run(self, kind: str, what: str, batch: int, times: int) -> tuple[float, float]:
        """Seconds of the clock and of the processor that some runs take."""
        assert self._process.stdin is not None
        asked = {"do": kind, "what": what, "batch": batch, "times": times}
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        answer = self._answer()
        return answer["seconds"], answer["cpu"]

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"the peer ended; run {PEER_SCRIPT} by hand to see why")
        return json.loads(line)


Timed = Callable[[int], tuple[float, ...]]
CLOCKS = ("ms", "cpu_ms", "kernel_ms")


def timed(run: Callable[[], Any], kernel: Callable[[], float] = lambda: 0.0) -> Timed:
    """A function that runs another some times and returns seconds of the clock, of the processor and in kernels."""

    def take(times: int) -> tuple[float, ...]:
        own, begin, cpu = kernel(), time.perf_counter(), time.process_time()
        for _ in range(times):
            run()
        return time.perf_counter() - begin, time.process_time() - cpu, kernel() - own

    return take


def measure(
    workers: dict[str, Timed], world: str, batch: int, repeats: int, steps: int
) -> list[dict[str, Any]]:
    """Run all in turn; milliseconds of one run by each clock, and their ratio to "forward"."""
    times, taken = {}, {name: [] for name in workers}
    for name, work in workers.items():
        work(1)
        times[name] = max(1, round(LEAST_SECONDS / work(1)[0]))
    for repeat in range(repeats):
        for name, work in workers.items():
            if name not in SLOW or repeat < 2:
                taken[name].append(np.array(work(times[name])) / times[name] * 1e3)
    rows = []
    for name, runs in taken.items():
        row: dict[str, Any] = {"world": world, "steps": steps, "batch": batch, "work": name}
        for column, clock in enumerate(CLOCKS):
            own = np.array([run[column] for run in runs if len(run) > column])
            if len(own) and own.any():
                base = np.array([run[column] for run in taken["forward"][: len(own)]])
                row |= _spread(clock, own) | _spread(f"ratio_{clock}", own / base)
        rows.append(row)
    return rows


def _spread(name: str, values: np.ndarray) -> dict[str, float]:
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75]).tolist()
    return {name: middle, f"{name}_low": low, f"{name}_high": high}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batch", type=int, nargs="+", default=[1, 64, 256, 1024])
    parser.add_argument("--worlds", nargs="+", default=gradient_work.WORLDS, choices=gradient_work.WORLDS)
    parser.add_argument("--steps", type=int, default=50, help="of the agent")
    parser.add_argument("--schedules", type=int, default=SCHEDULES, help="different timings")
    parser.add_argument("--repeats", type=int, default=11)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--eager", action="store_true", help="eager autograd too, up to 256 environments")
    parser.add_argument("--peer", action="store_true", help="JAX too: REX and a loop written by hand")
    parser.add_argument("--compile", action="store_true", help="torch.compile too, of 256 environments")
    parser.add_argument(
        "--differences", type=int, nargs="+", default=[], help="finite differences of this many unknowns too"
    )
    parser.add_argument("--out", type=Path, help="CSV to write; must not be there")
    given = parser.parse_args(arguments)
    if given.out is not None and given.out.exists():
        parser.error(f"{given.out} exists; choose another name")
    torch.set_num_threads(1)
    peer, rows = Peer(given.steps) if given.peer else None, []
    for world in given.worlds:
        for batch in given.batch:
            make = {
                name: Ours(world, "fused", batch, given.steps, given.threads, given.schedules)
                for name in OURS
            }
            workers = {name: timed(OURS[name](ours), ours.kernel_seconds) for name, ours in make.items()}
            for unknowns in given.differences:  # every point is an environment of one batch
                more = Ours(
                    world, "fused", batch * (unknowns + 1), given.steps, given.threads, given.schedules
                )
                workers[f"differences_{unknowns}"] = timed(more.forward(), more.kernel_seconds)
            if given.eager and batch <= 256:
                workers["eager"] = timed(Ours(world, "eager", batch, given.steps).gradient())
            if given.compile and world == "pendulum" and batch == 256:
                workers["compiled"] = timed(compiled(batch, given.steps))
            if peer is not None and world == "pendulum":
                for kind in ("rex", "scan"):
                    workers[kind] = lambda n, k=kind, b=batch: peer.run(k, "gradient", b, n)
            rows += measure(workers, world, batch, given.repeats, given.steps)
            sys.stdout.write(table(rows[-len(workers) :]))
            sys.stdout.flush()
    if given.out is not None:
        rollout_speed.write_csv(given.out, rows)
    return 0


def table(rows: list[dict[str, Any]]) -> str:
    """What was measured, for people: medians with quartiles of the ratio."""
    lines = []
    for r in rows:
        ratios = [
            f"{name} {r[key]:.2f} [{r[key + '_low']:.2f}, {r[key + '_high']:.2f}]"
            for name, key in (("CPU", "ratio_cpu_ms"), ("kernel", "ratio_kernel_ms"))
            if key in r
        ]
        lines.append(
            f"{r['world']:10s} {r['batch']:6d} {r['work']:9s} {r['ms']:9.3f} ms {r['cpu_ms']:9.3f} CPU ms  "
            f"x forward: {', '.join(ratios)}"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    raise SystemExit(main())
