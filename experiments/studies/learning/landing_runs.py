"""One unit of the study of landings: it is identified, and landed by hand-made controllers or a policy trained for it.

    python -m experiments.studies.learning.landing_runs delays 0 result.json

Each is a process of its own, so that its processor time is all that it took: imports, compilation, identification,
training and flights.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from gymnasium.vector import VectorEnv

from baselines.ppo.config import PpoConfig
from baselines.ppo.policy import PpoPolicy
from baselines.ppo.training import PpoTrainer
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.envs.landing.landing_env import LandingVectorEnv
from deepkoco.envs.landing.seat import CENTRE, SCALE
from deepkoco.output.whole_file import write_whole_text
from deepkoco.runs.configs import CONFIGS
from deepkoco.systems import make_system
from deepkoco.systems.bodies.quadrotor import attitude_for
from deepkoco.yaml_file import read_yaml
from experiments.studies.diagnosis.identify_quadrotor import DELAYS
from experiments.studies.learning.circle_runs import identified, make_unit
from experiments.studies.learning.landing_guidance import GuidedLanding
from experiments.studies.learning.landing_unit import FLIGHT_STEPS, LandingUnits

TASK = "inclined_landing"
METHODS = ("without", "delays")  # of the training: without any delay, and with those that are known
LEVEL = "level"  # a controller made by hand that follows the deck and comes down level
GUIDED = (
    "guided_without",
    "guided_delays",
)  # one that ends in the deck's attitude: it knows of no delay, or of those
KINDS = {"by_hand": (LEVEL, *GUIDED), **{method: (method,) for method in METHODS}}
"""The ways of landing that one run tries."""
FURTHER = 0.04  # delay of the commands beyond those of the thesis, of radio and motion capture [s]
DECK_DELAYS = (0.08, 0.12)  # of the measured deck; each unit has one of these [s]
HISTORY = 12  # past actions that are seen: 240 ms
SPREAD, DELAY_SPREAD = 0.05, 0.006  # parameters vary by this share about their estimates, delays by this [s]
INCLINES = tuple(np.radians((0.0, 5.0, 10.0, 15.0, 20.0, 25.0)).tolist())  # [rad]
SPEEDS = (0.0, 0.25, 0.5, 0.75, 1.0)  # [m/s]
FLIGHTS = 20  # of each cell
FILMED = ((0.0, 0.5), (INCLINES[3], 0.5), (INCLINES[5], 1.0))  # incline [rad], speed [m/s]
TOLD = ("offset", "sink", "slip", "tilt")
GAINS = (3.0, 3.0)  # of the controller tuned by hand: place [1/s2], velocity [1/s]
DESCENT = 0.4  # its speed over the deck's centre [m/s]
NEAR = 0.12  # it comes down where it is closer than this to the axis of the deck [m]


class Controller(Protocol):
    """What acts."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions (B, 3) for observations (B, N)."""
        ...


class LevelLanding:
    """Follows the deck by proportional and derivative control, and comes down at a constant speed over its centre.

    Args:
        mass: Of the body, as identified [kg].
    """

    def __init__(self, mass: float) -> None:
        self.mass = mass

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions (B, 3); see `Controller`."""
        return np.array([self._action(row) for row in observations])

    def _action(self, row: np.ndarray) -> np.ndarray:
        place, velocity = row[:3], row[3:6]
        near = np.hypot(place[0], place[1]) < NEAR
        wanted = np.array([*(-GAINS[0] * place[:2]), 0.0 if near else GAINS[0] * (0.4 - place[2])])
        wanted -= GAINS[1] * (velocity - [0.0, 0.0, -DESCENT if near else 0.0])
        most = np.array([3.0, 3.0, 3.0])
        command = attitude_for(tuple(np.clip(wanted, -most, most)), self.mass)
        return (np.array(command) - CENTRE) / SCALE


def by_hand(method: str, values: Mapping[str, float]) -> Controller:
    """A controller that is made by hand.

    Args:
        method: `LEVEL`, or one of `GUIDED`.
        values: What was identified of the unit. The delay of its deck is known to lie in `DECK_DELAYS`.
    """
    if method == LEVEL:
        return LevelLanding(values["mass"])
    if method == GUIDED[0]:
        return GuidedLanding({**values, **dict.fromkeys(DELAYS, 0.0)}, 0.0)
    return GuidedLanding(values, float(np.mean(DECK_DELAYS)))


def deck_delay(seed: int) -> float:
    """Delay of the measured deck of a unit [s]."""
    return float(np.random.default_rng([seed, 25]).uniform(*DECK_DELAYS))


def make_simulation(method: str, values: Mapping[str, float]) -> Callable[[int, int], VectorEnv]:
    """The factory of the environments of a training.

    Args:
        method: One of `METHODS`.
        values: Parameters and delays of the commands, about which episodes draw theirs.
    """
    ranges = {f"world.{name}": _about(name, value, SPREAD * value) for name, value in values.items()}
    for name in DELAYS:
        ranges[f"world.{name}"] = (
            (0.0, 0.0) if method == "without" else _about(name, values[name], DELAY_SPREAD)
        )
    if method != "without":
        ranges["deck_sensor->agent"] = DECK_DELAYS

    def make(count: int, seed: int) -> VectorEnv:
        return LandingVectorEnv(
            count, FLIGHT_STEPS, action_history=HISTORY, deck_delay=0.0, randomize=ranges, delay_traces=64
        )

    return make


def _about(name: str, value: float, spread: float) -> tuple[float, float]:
    declared = make_system("quadrotor").parameter(name)
    return max(value - spread, declared.low), min(value + spread, declared.high)


def make_config(**changes: Any) -> PpoConfig:
    """The settings of configs/agent_on_task, without a comparison with references.

    Args:
        **changes: Of single settings.
    """
    stored = read_yaml(CONFIGS / "agent_on_task" / f"ppo_{TASK}.yaml")["agent"]
    rare = {"evaluation_every": 4000, "final_evaluation_episodes": 64, "checkpoint_episodes": 100000}
    return PpoConfig(**{**stored, "reference_episodes": 0, **rare, **changes})


def land(
    controller: Controller,
    true: Mapping[str, float],
    late: float,
    cells: Sequence[tuple[float, float]],
    seed: int,
) -> tuple[list[dict[str, Any]], list[dict[str, np.ndarray]]]:
    """Land on a unit.

    Args:
        controller: What acts.
        true: Parameters and delays of the unit.
        late: Mean delay of its measured deck [s].
        cells: Incline [rad] and speed [m/s] of each deck.
        seed: Of starts, decks, noise and jitter.

    Returns:
        Of each deck: success, whether it touched, when [s], and what is told of the touch-down. Of each step: places,
        decks, normals, axes and whether they have touched.
    """
    incline, speed = np.array(cells).T
    units = LandingUnits(true, incline, speed, late, HISTORY)
    observation, info = units.reset(seed=seed)
    time_of, ended = np.full(len(cells), np.nan), np.zeros(len(cells), bool)
    steps = [_seen(info)]
    for step in range(FLIGHT_STEPS):
        observation, _, now, _, info = units.step(controller.act(observation.astype(np.float64)))
        time_of = np.where(now & ~ended, 0.02 * (step + 1), time_of)
        ended |= now
        steps.append(_seen(info))
        if ended.all():
            break
    rows = []
    for k, (i, v) in enumerate(cells):
        row = {"incline": round(i, 6), "speed": v, "success": bool(info["success"][k])}
        told = {"time": time_of[k], **{n: info[n][k] for n in TOLD}}
        rows.append(
            {**row, "touched": bool(info["touched"][k]), **{n: round(float(x), 4) for n, x in told.items()}}
        )
    return rows, steps


def _seen(info: Mapping[str, Any]) -> dict[str, np.ndarray]:
    return {name: info[name] for name in ("place", "deck", "normal", "axis", "touched")}


def run(kind: str, seed: int, episodes: int | None) -> dict[str, Any]:
    """Identify a unit, make what lands it, and land it on a grid of inclines and speeds.

    Args:
        kind: One of `KINDS`.
        seed: Of the unit and the training.
        episodes: Of a training; None: as stored.

    Returns:
        The unit and what was identified; and by way cost, steps and processor seconds of a training, the landings, and
        the filmed ones step by step.
    """
    begun = time.process_time()
    true, late = make_unit(seed, FURTHER), deck_delay(seed)
    values = identified(true, seed)
    fitted = time.process_time() - begun
    first = derive_seed(seed, Purpose.FINAL_EVALUATION) % 2**31
    cells = [(i, v) for i in INCLINES for v in SPEEDS for _ in range(FLIGHTS)]
    ways = {}
    for method in KINDS[kind]:
        begun, last = time.process_time(), {"cost": float("nan"), "steps": 0.0}
        policy: PpoPolicy | None = None
        if method in METHODS:
            policy, last = train(method, seed, values, episodes)
        training = {**last, "cpu_seconds": time.process_time() - begun}
        landings, _ = land(policy or by_hand(method, values), true, late, cells, first)
        _, steps = land(policy or by_hand(method, values), true, late, FILMED, first)
        film = {name: np.array([s[name] for s in steps]).round(4).tolist() for name in steps[0]}
        ways[method] = {"training": training, "landings": landings, "film": film}
    return {"true": {**true, "deck_delay": late}, "found": values, "fit_cpu_seconds": fitted, "ways": ways}


def train(
    method: str, seed: int, values: Mapping[str, float], episodes: int | None
) -> tuple[PpoPolicy, dict[str, float]]:
    """A policy for a unit, and cost in the simulation and steps of its training.

    Args:
        method: One of `METHODS`.
        seed: Of the training.
        values: What is known of the unit.
        episodes: Of the training; None: as stored.
    """
    config = make_config(**({} if episodes is None else {"total_episodes": episodes}))
    with tempfile.TemporaryDirectory() as folder:
        trainer = PpoTrainer(make_simulation(method, values), config, seed, Path(folder))
        last = trainer.run()
        return trainer.policy, {"cost": last["evaluation/cost"], "steps": last["steps"]}


def main(arguments: Sequence[str] | None = None) -> int:
    """Identify, train, land, and write the result as JSON; returns the exit status."""
    parser = argparse.ArgumentParser(description="Train policies for a hidden quadrotor and land it.")
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("seed", type=int)
    parser.add_argument("out", type=Path, help="new file")
    parser.add_argument("--training", type=int, default=None, help="episodes of the training")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    write_whole_text(args.out, json.dumps(run(args.kind, args.seed, args.training)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
