"""Speed of 64 environments of an MJCF arm on the delay graph, against `mujoco.rollout` alone, in one run.

The arm has six joints with position servos and steps of 2 ms. On the graph its world and its sensor run at 100 Hz, the
agent at 20 Hz, and commands and measurements are delayed. `mujoco.rollout` is given all commands at once: no delays,
no sensors, no agent. Both run in turn in one thread; the table has processor time.

    python -m experiments.benchmarks.mjcf_speed --out results/graph/mjcf_speed.csv
"""

import argparse
import csv
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepkoco.engines import MjcfObject, MujocoEngine, make_graph
from deepkoco.engines.mujoco_world import import_mujoco
from deepkoco.graph import BatchedRuntime, Input, Supervisor, draw_timing
from deepkoco.graph.model.node import Parameters, State
from deepkoco.output.whole_file import whole_file

RATE, WORLD_RATE, SECONDS = 20, 100, 5
DELAYS = {
    "constant": {"actuation_delay": 0.011, "sensing_delay": 0.007},
    "random": {
        "actuation_delay": {"law": "gaussian", "loc": 0.011, "scale": 0.003},
        "sensing_delay": {"law": "gaussian", "loc": 0.007, "scale": 0.002},
    },
}
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
LENGTHS = (0.08, 0.12, 0.13, 0.06, 0.05, 0.04)


def arm_xml() -> str:
    """A desktop arm of six hinges, each with a position servo."""
    bodies, ends = "", ""
    for i, (axis, length) in enumerate(zip(AXES, LENGTHS, strict=True)):
        place = 'pos="0 0 0"' if i == 0 else f'pos="{LENGTHS[i - 1]} 0 0"'
        bodies += f"""<body name="link{i}" {place}><joint name="joint{i}" axis="{axis}" damping="0.2" armature="0.01"
            range="-2 2"/><geom type="capsule" fromto="0 0 0 {length} 0 0" size="0.015" mass="{0.2 - 0.02 * i}"
            contype="0" conaffinity="0"/>"""
        ends += "</body>"
    servos = "".join(
        f'<position name="servo{i}" joint="joint{i}" kp="15" kv="0.3"/>' for i in range(len(AXES))
    )
    return f"""<mujoco model="arm"><compiler autolimits="true"/><option timestep="0.002" integrator="implicitfast"/>
        <worldbody>{bodies}{ends}</worldbody><actuator>{servos}</actuator></mujoco>"""


class Looker(Supervisor):
    """Shows the newest measurement."""

    inputs = ("sensor",)

    def observe(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], action: torch.Tensor
    ) -> tuple[State, dict[str, torch.Tensor]]:
        return state, {"observation": inputs["sensor"].data[:, -1]}


def graph_work(batch: int, delays: str, actions: torch.Tensor) -> Any:
    """A function that runs the environments on the graph and returns the last observations (B, N)."""
    agent = Looker("agent", RATE, initial_action=torch.zeros(len(AXES), dtype=torch.float64))
    engine = MujocoEngine(world_rate=WORLD_RATE)
    graph = make_graph(MjcfObject(arm_xml()), engine, agent=agent, **DELAYS[delays])
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), len(actions), batch))

    def run() -> np.ndarray:
        state, _ = runtime.reset({}, torch.Generator().manual_seed(0))
        return runtime.rollout(state, actions)[1]["observation"][-1].numpy()

    return run


def rollout_work(batch: int, actions: torch.Tensor) -> Any:
    """A function that runs as many steps of the physics by `mujoco.rollout` and returns the last states (B, n)."""
    mujoco = import_mujoco()
    from mujoco import rollout

    model = MjcfObject(arm_xml()).compile()
    each = round(1 / RATE / model.opt.timestep)
    controls = np.repeat(actions.numpy().transpose(1, 0, 2), each, axis=1)
    start = np.zeros((batch, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    pool, data = rollout.Rollout(nthread=0), mujoco.MjData(model)

    def run() -> np.ndarray:
        return np.asarray(pool.rollout(model, [data], start, controls)[0])[:, -1]

    return run


def seconds_of(work: Any) -> float:
    """Processor time of a call [s]."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--batch", type=int, nargs="+", default=[64])
    parser.add_argument("--times", type=int, default=7, help="measurements of each, in turn")
    parser.add_argument("--out", type=Path, help="CSV file to write")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(0)
    rows = []
    for batch in arguments.batch:
        actions = 0.5 * torch.randn(
            RATE * SECONDS, batch, len(AXES), generator=generator, dtype=torch.float64
        )
        works = {kind: graph_work(batch, kind, actions) for kind in DELAYS} | {
            "rollout": rollout_work(batch, actions)
        }
        for work in works.values():
            work()
        times = {kind: [] for kind in works}
        for _ in range(arguments.times):
            for kind, work in works.items():
                times[kind].append(seconds_of(work))
        physics = batch * SECONDS / 0.002
        for kind in DELAYS:
            shares = [r / g for r, g in zip(times["rollout"], times[kind], strict=True)]
            ours, alone = statistics.median(times[kind]), statistics.median(times["rollout"])
            rows.append(
                {
                    "environments": batch,
                    "delays": kind,
                    "graph_physics_steps_per_cpu_s": round(physics / ours),
                    "rollout_physics_steps_per_cpu_s": round(physics / alone),
                    "ratio": round(statistics.median(shares), 3),
                    "lowest_ratio": round(min(shares), 3),
                    "highest_ratio": round(max(shares), 3),
                }
            )
            print(rows[-1])
    if arguments.out:
        with whole_file(arguments.out) as path, path.open("w", newline="") as file:
            table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            table.writeheader()
            table.writerows(rows)


if __name__ == "__main__":
    main()
