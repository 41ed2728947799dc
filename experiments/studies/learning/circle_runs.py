"""One unit of the study of circle following: it is identified, policies are trained for it and flown on it.

    python -m experiments.studies.learning.circle_runs unit 0 result.json

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
from typing import Any

import numpy as np
import torch
from gymnasium.vector import VectorEnv

from baselines.ppo.config import PpoConfig
from baselines.ppo.policy import PpoPolicy
from baselines.ppo.training import PpoTrainer
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.envs.delay_env import DelayGraphVectorEnv
from deepkoco.envs.estimator_wrapper import VectorEstimatorWrapper
from deepkoco.fit import fit
from deepkoco.output.whole_file import write_whole_text
from deepkoco.runs.configs import CONFIGS
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.yaml_file import read_yaml
from experiments.studies.diagnosis.identify_quadrotor import DELAYS, PARAMETERS, Flight, hidden
from experiments.studies.learning.circle_unit import SIMULATION, QuadrotorUnits

TASK = "quadrotor_circle"
METHODS = ("without", "delays")  # of the training: without any delay, and with those that were identified
FURTHER = 0.08  # delay of the unit beyond those of the thesis, of radio and motion capture [s]
SWEEP = (0.0, 0.02, 0.04, 0.06, 0.08, 0.1)  # further delays of flights of the same policies [s]
HISTORY = 12  # past actions that are seen: 240 ms, longer than delays and half of the attitude's answer
SPREAD, DELAY_SPREAD = 0.05, 0.006  # parameters vary by this share about their estimates, delays by this [s]
EPISODE_STEPS = 250
CIRCLES = ((0.25, 0.8), (0.5, 1.0), (1.0, 1.2))  # radius [m], speed [m/s]
FLIGHTS = 6  # of each circle
DRAWN = FLIGHTS  # the first flight of the second circle
FLIGHT_STEPS, SETTLED = 300, 100  # of a flight, and from which on the error counts


def make_unit(seed: int, further: float) -> dict[str, float]:
    """True parameters and delays of a unit; the same unit with another further delay [s]."""
    return {name: value + (further if name in DELAYS else 0.0) for name, value in hidden(seed).items()}


def identified(true: Mapping[str, float], seed: int) -> dict[str, float]:
    """Parameters and delays from 21 s of flight, as in `experiments.studies.diagnosis.identify_quadrotor`."""
    found = fit([Flight(true, seed + 1000).fly()], "quadrotor", [*PARAMETERS, *DELAYS])
    return {name: float(estimate.value) for name, estimate in found.estimates.items()}


def make_simulation(method: str, values: Mapping[str, float]) -> Callable[[int, int], VectorEnv]:
    """The factory of the environments of a training.

    Args:
        method: One of `METHODS`.
        values: Parameters and delays, about which episodes draw theirs.
    """
    ranges = {name: _about(name, value, SPREAD * value) for name, value in values.items()}
    for name in DELAYS:
        ranges[name] = (0.0, 0.0) if method == "without" else _about(name, values[name], DELAY_SPREAD)

    def make(count: int, seed: int) -> VectorEnv:
        return DelayGraphVectorEnv(
            count, EPISODE_STEPS, noise=True, action_history=HISTORY, randomize=ranges, **SIMULATION
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
    return PpoConfig(**{**stored, "reference_episodes": 0, "final_evaluation_episodes": 64, **changes})


def fly(
    policy: PpoPolicy, true: Mapping[str, float], model: Mapping[str, float] | None, seed: int
) -> tuple[dict[str, list[float]], np.ndarray]:
    """Fly on a unit.

    Args:
        policy: What acts.
        true: Parameters and delays of the unit.
        model: What an estimator between them knows of the unit, to predict the state; None: there is none.
        seed: Of noise and jitter.

    Returns:
        Mean distances from the circle after the first two seconds [m], by radius; and places (T, B, 3) along the way.
    """
    circles = [circle for circle in CIRCLES for _ in range(FLIGHTS)]
    envs: VectorEnv = QuadrotorUnits(true, circles, action_history=HISTORY)
    if model is not None:
        known = ExtendedSystem(make_system("quadrotor"), (), model)
        envs = VectorEstimatorWrapper(envs, "predicted", model=known)
    observation, _ = envs.reset(seed=seed)
    errors, places = [], []
    for _ in range(FLIGHT_STEPS):
        actions = policy.act(observation.astype(np.float64)).astype(np.float32)
        observation, *_, info = envs.step(actions)
        errors.append(info["path_error"])
        places.append(info["place"])
    means = np.array(errors[SETTLED:]).mean(0).reshape(len(CIRCLES), FLIGHTS)
    by_radius = {f"{radius:g}": row.tolist() for (radius, _), row in zip(CIRCLES, means, strict=True)}
    return by_radius, np.array(places)


def run(seed: int, episodes: int | None) -> dict[str, Any]:
    """Identify a unit, train for it with each of the methods and fly on it.

    Args:
        seed: Of the unit and the trainings.
        episodes: Of a training; None: as stored.

    Returns:
        Estimates; of each training cost and processor seconds; and flights: method, further delay, estimator, errors by
        radius, one way.
    """
    begun = time.process_time()
    values = identified(make_unit(seed, FURTHER), seed)
    fitted = time.process_time() - begun
    trainings: dict[str, dict[str, float]] = {}
    flights: list[dict[str, Any]] = []
    for method in METHODS:
        begun = time.process_time()
        policy, cost = train(method, seed, values, episodes)
        trainings[method] = {"cost": cost, "cpu_seconds": time.process_time() - begun}
        flights += flights_of(method, policy, seed, values)
    return {
        "true": make_unit(seed, FURTHER),
        "found": values,
        "fit_cpu_seconds": fitted,
        "trainings": trainings,
        "flights": flights,
    }


def train(
    method: str, seed: int, values: Mapping[str, float], episodes: int | None
) -> tuple[PpoPolicy, float]:
    """A policy for a unit, and its cost in the simulation.

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
        return trainer.policy, last["evaluation/cost"]


def flights_of(
    method: str, policy: PpoPolicy, seed: int, values: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Flights of a policy on its unit, under each further delay, and where it knows none with a predicted state too."""
    ways: list[tuple[float, Mapping[str, float] | None]] = [(further, None) for further in SWEEP]
    if method == "without":
        ways.append((FURTHER, values))
    first = derive_seed(seed, Purpose.FINAL_EVALUATION) % 2**31
    flights = []
    for further, model in ways:
        errors, places = fly(policy, make_unit(seed, further), model, first)
        flights.append(
            {
                "method": method,
                "further_delay": further,
                "predicted": model is not None,
                "errors": errors,
                "places": places[:, DRAWN].round(4).tolist() if further == FURTHER else None,
            }
        )
    return flights


def main(arguments: Sequence[str] | None = None) -> int:
    """Identify, train, fly and write the result as JSON; returns the exit status."""
    parser = argparse.ArgumentParser(description="Train policies for a hidden quadrotor and fly them.")
    parser.add_argument("kind", choices=["unit"])
    parser.add_argument("seed", type=int)
    parser.add_argument("out", type=Path, help="new file")
    parser.add_argument("--training", type=int, default=None, help="episodes of the training")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    write_whole_text(args.out, json.dumps(run(args.seed, args.training)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
