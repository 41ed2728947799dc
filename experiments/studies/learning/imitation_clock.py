"""A student that learns the swing-up in a delay graph, in simulated and in wall-clock time, with the same nodes.

    python -m experiments.studies.learning.imitation_clock --out results/imitation

A script answers: it pumps energy and holds the pendulum upright. Its answers come 0.1 to 0.3 s late in simulated time,
and as the processes send them by the clock. Each student first sees a demonstration, then asks about a share of its
own steps.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from baselines.imitation.asking import Always, make_rule
from baselines.imitation.config import ImitationConfig
from baselines.imitation.graph import AskingStudent, imitation_graph
from baselines.imitation.learner import Learner
from baselines.imitation.nodes import NOT_ASKED, Script
from baselines.imitation.policy import make_ensemble
from deepkoco.graph import Episode, Graph, Input, Uniform, draw_timing
from deepkoco.graph.live import SimulatedRuntime, WallClockRuntime, node_times
from deepkoco.systems import make_system

STEPS, RATE, LIMIT = 200, 20.0, 2.0  # of an episode; of the student [Hz]; torque [N m]
ROUNDS = 12


def swing_up(seen: Tensor) -> Tensor:
    """Torque (B, 1) of the teacher for cosine, sine and speed (B, 3) of the rod pendulum of 1 kg, 1 m, g = 10 m/s2."""
    cosine, sine, speed = seen.unbind(-1)
    energy = speed.square() / 6.0 + 5.0 * (cosine - 1.0)  # less that of the rest upright [J]
    pump = -3.0 * energy * speed
    hold = -12.0 * torch.atan2(sine, cosine) - 3.0 * speed
    return torch.where((cosine > 0.9) & (speed.abs() < 3.0), hold, pump).clamp(-LIMIT, LIMIT)[:, None]


def observe(measured: Tensor) -> Tensor:
    """What the student sees (1, 3) of angle and speed (1, 2)."""
    return torch.cat([measured[:, :1].cos(), measured[:, :1].sin(), measured[:, 1:]], -1)


def graph() -> Graph:
    """Pendulum, student and teacher."""
    return imitation_graph(
        "rod_pendulum",
        Script(swing_up),
        3,
        1,
        control_rate=RATE,
        answer_delay=Uniform(0.1, 0.3),
        sensing_delay=0.005,
    )


def cost_of(episode: Episode) -> float:
    """Cost of an episode as of Gymnasium's Pendulum-v1, at the steps of the student, without the torque's share."""
    states = torch.as_tensor(np.asarray(episode.outputs["world"])).reshape(-1, 2)
    chosen = states[torch.linspace(0, len(states) - 1, STEPS).long()]
    angle = torch.remainder(chosen[:, 0] + torch.pi, 2 * torch.pi) - torch.pi
    return float((angle.square() + 0.1 * chosen[:, 1].square()).sum())


class ActingScript:
    """The teacher in the place of the student: acts at once and asks nobody."""

    def __call__(self, inputs: Mapping[str, Input]) -> Tensor:
        seen = observe(inputs["sensor"].data[:, -1]).double()
        return torch.cat([swing_up(seen), torch.full_like(seen[:, :1], NOT_ASKED), seen], -1)


def start_of(generator: torch.Generator) -> Tensor:
    """A pendulum that hangs, nearly (1, 2)."""
    return (torch.tensor([[3.0, 0.0]]) + 0.2 * torch.randn(1, 2, generator=generator)).double()


def script_costs(seed: int, episodes: int = ROUNDS) -> list[dict[str, float]]:
    """What the teacher itself pays in simulated time.

    Args:
        seed: Of start states.
        episodes: How many.

    Returns:
        A row for each episode.
    """
    own, generator, rows = graph(), torch.Generator().manual_seed(seed), []
    values = make_system("rod_pendulum").default_parameters()
    for number in range(episodes):
        start = start_of(generator)
        parameters = {name: values | {"start": start} for name in ("world", "sensor")}
        timing = draw_timing(own, np.random.default_rng([seed, number]), steps=STEPS, batch=1)
        with SimulatedRuntime(own, timing) as runtime:
            runtime.reset(parameters, generator)
            runtime.run(ActingScript(), STEPS)
            rows.append({"episode": number, "cost": cost_of(runtime.finish())})
    return rows


def learn(clock: bool, seed: int, rounds: int = ROUNDS) -> list[dict[str, float]]:
    """Learn in one kind of time.

    Args:
        clock: By the clock; else in simulated time.
        seed: Of start states, weights and delays.
        rounds: Episodes, the first is the demonstration.

    Returns:
        A row for each episode.
    """
    own = graph()
    config = ImitationConfig(query_rate=0.2, updates=400, minibatch=64)
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        learner = Learner(make_ensemble(3, np.array([-LIMIT]), np.array([LIMIT]), config), config)
    student = AskingStudent(learner, Always(), observe, acts=True)
    values, rows = make_system("rod_pendulum").default_parameters(), []
    for number in range(rounds):
        start = start_of(generator)
        parameters = {name: values | {"start": start} for name in ("world", "sensor")}
        timing = draw_timing(own, np.random.default_rng([seed, number]), steps=STEPS, batch=1)
        student.start()
        with WallClockRuntime(own) if clock else SimulatedRuntime(own, timing) as runtime:
            runtime.reset(parameters, generator)
            runtime.run(student, STEPS)
            episode = runtime.finish()
        late = node_times(own, episode, "agent").overruns if clock else 0
        error = student.learn(generator, generator)
        rows.append(
            {"episode": number, "asked": student.asked, "answered": student.answered, "answers": len(learner.labels),
             "cost": cost_of(episode), "error": error, "overruns": late}
        )  # fmt: skip
        student.rule, student.acts = (
            make_rule(ImitationConfig(rule="random", query_rate=0.2), generator),
            False,
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Imitation in a graph, in simulated and in wall-clock time.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for seed in args.seeds:
        rows += [{"time": "teacher", "seed": seed, **row} for row in script_costs(seed)]
        for time, clock in (("simulated", False), ("wall-clock", True)):
            found = learn(clock, seed)
            rows += [{"time": time, "seed": seed, **row} for row in found]
            text = ", ".join(f"{row['cost']:.0f}" for row in found)
            print(f"{time}, seed {seed}: {found[-1]['answers']} answers, costs {text}", flush=True)
    pd.DataFrame(rows).to_csv(args.out / "graph.csv", index=False, float_format="%.4f")
    return 0


if __name__ == "__main__":
    sys.exit(main())
