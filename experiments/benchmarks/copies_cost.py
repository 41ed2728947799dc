"""Processor time of a step of a control-suite task among K copies of itself, without an agent.

python -m experiments.benchmarks.copies_cost --task cartpole swingup 4 --copies 0 5 20
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import gymnasium
import numpy as np

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.envs.distractors import DistractorOptions, StateDistractors
from deepkoco.envs.distractors.drives import ACTION, DRIVES

STEPS = 200


def among(task: Sequence[str], copies: int, drive: str) -> gymnasium.Env:
    """The task among so many copies of itself; alone at 0.

    Args:
        task: Domain, task and action repeat.
        copies: K.
        drive: Of the copies.
    """
    domain, name, repeat = task
    env = gymnasium.make("deepkoco/DmControl-v0", domain=domain, task=name, action_repeat=int(repeat))
    return StateDistractors(env, "copies", DistractorOptions(copies=copies, drive=drive)) if copies else env


def processor_seconds(env: gymnasium.Env, seed: int, steps: int = STEPS) -> float:
    """Processor time of a step under random actions [s]."""
    env.reset(seed=seed)
    env.action_space.seed(seed)
    begun = time.process_time()
    for _ in range(steps):
        env.step(env.action_space.sample())
    return (time.process_time() - begun) / steps


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Processor time of a step among copies.")
    parser.add_argument(
        "--task", nargs=3, default=["cartpole", "swingup", "4"], metavar=("DOMAIN", "TASK", "REPEAT")
    )
    parser.add_argument("--copies", type=int, nargs="+", default=[0, 5, 20], help="numbers of copies")
    parser.add_argument("--times", type=int, default=5, help="episodes, of which the median is told")
    args = parser.parse_args(arguments)
    for copies in args.copies:
        for drive in [*DRIVES, ACTION] if copies else ["alone"]:
            env = among(args.task, copies, drive)
            begun = time.process_time()
            env.reset(seed=0)  # records what its copies play
            reset = time.process_time() - begun
            step = np.median([processor_seconds(env, 0) for _ in range(args.times)])
            print(
                f"K = {copies:2}, {drive:6}: {1e3 * step:.3f} ms a step, first reset {1e3 * reset:.0f} ms",
                flush=True,
            )
            env.close()


if __name__ == "__main__":
    main()
