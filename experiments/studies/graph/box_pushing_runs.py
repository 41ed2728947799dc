"""Episodes of box pushing by sampling planners that know the delays, or do not; one method and seed a process.

python -m experiments.studies.graph.box_pushing_runs mppi_delays 0 RESULT.json
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from deepkoco.engines.boxpush.world import box_state
from deepkoco.envs.boxpush import BoxPushOptions, box_push_graph
from deepkoco.envs.boxpush.boxpush_env import BoxPushVectorEnv
from deepkoco.envs.boxpush.model_start import ModelStart
from deepkoco.envs.graph_rollouts import GraphRollouts
from deepkoco.output.whole_file import write_whole_text
from deepkoco.planning.sampling import SamplingConfig, SamplingPlanner

STARTS = 7  # start states of a seed
STEPS = 50  # of 0.1 s
MODEL_STEP = 0.01
"""Of the planner's physics [s]; that of the world is half of it."""
MPPI = SamplingConfig("mppi", horizon=12, samples=24)
CEM = SamplingConfig("cem", horizon=12, samples=12, iterations=2, elites=4)


class Method(NamedTuple):
    """A planner and what it knows.

    Attributes:
        config: Of the planner.
        take: From which state its model is rolled out, see `ModelStart`.
        delays: Its model has the mean delays.
    """

    config: SamplingConfig
    take: str
    delays: bool


METHODS = {
    "mppi_delays": Method(MPPI, "past", True),
    "mppi_without": Method(MPPI, "newest", False),
    "mppi_one_instant": Method(MPPI, "one instant", False),
    "cem_delays": Method(CEM, "past", True),
    "cem_without": Method(CEM, "newest", False),
}


def push(
    method: Method, seed: int, starts: int = STARTS, steps: int = STEPS
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Push boxes, all at once, on the same starts, frictions, delays and noise for every method.

    Args:
        method: One of `METHODS`.
        seed: Of the world and of the planner's samples.
        starts: Start states.
        steps: Of an episode.

    Returns:
        Distances (steps + 1, starts) from the boxes to their goals [m], which stay once a box is lost; and what is
        needed to film the first of them.
    """
    envs = BoxPushVectorEnv(starts, steps + 1, delay_traces=starts)
    model = box_push_graph(BoxPushOptions(noise=False, history=0, time_step=MODEL_STEP))
    beginning = ModelStart(model, 1.0 / envs.dt, method.take)
    rollouts = GraphRollouts(model, method.config.horizon + 5, delays=method.delays)
    rng = np.random.default_rng([seed, 1])
    planner = SamplingPlanner(method.config, starts, -np.ones(2), np.ones(2), rng)
    observation, info = envs.reset(seed=seed)
    distances, film = [info["distance"]], [_pose(envs)]
    ended = np.zeros(starts, bool)
    for _ in range(steps):
        beginning.see(observation)
        groups = beginning.groups()

        def costs(plans: np.ndarray, groups: Any = groups) -> np.ndarray:
            found = np.empty(plans.shape[:2])
            for which, start, past in groups:
                found[which] = rollouts.costs(start, past, plans[which])
            return found

        action = planner.decide(costs)
        beginning.act(action)
        observation, _, terminated, _, info = envs.step(action.astype(np.float32))
        # A box that has left stays where it was lost; the environment has begun another episode.
        distances.append(np.where(ended, distances[-1], info["distance"]))
        ended |= terminated
        film.append(_pose(envs))
    shown = {name: np.array([pose[name] for pose in film]) for name in film[0]}
    return np.array(distances), shown


def _pose(envs: BoxPushVectorEnv) -> dict[str, np.ndarray]:
    """Of the first environment, as `draw_box_push` takes it."""
    seen = box_state(envs.state.nodes["world"]["seen"])
    return {
        "angles": seen.angles[0].numpy().copy(),
        "box": seen.place[0].numpy().copy(),
        "yaw": seen.yaw[0].numpy().copy(),
        "goal": envs.state.nodes["agent"]["goal"][0].numpy().copy(),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Push, and write the result as JSON; returns the exit status."""
    parser = argparse.ArgumentParser(description="Push boxes by a sampling planner.")
    parser.add_argument("method", choices=list(METHODS))
    parser.add_argument("seed", type=int)
    parser.add_argument("out", type=Path, help="new file")
    parser.add_argument("--starts", type=int, default=STARTS)
    parser.add_argument("--steps", type=int, default=STEPS)
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    distances, film = push(METHODS[args.method], args.seed, args.starts, args.steps)
    result = {
        "distances": distances.round(5).tolist(),
        "film": {name: value.round(4).tolist() for name, value in film.items()},
    }
    write_whole_text(args.out, json.dumps(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
