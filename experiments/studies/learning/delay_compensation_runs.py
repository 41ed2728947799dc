"""One policy of the study of delay compensation: trained in its simulation, then run on a unit with delays.

    python -m experiments.studies.learning.delay_compensation_runs predicted 0 result.json

Each is a process of its own, so that its processor time is all that it took: imports, compilation, training and
evaluations.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.vector import SyncVectorEnv, VectorEnv

from baselines.ppo.config import PpoConfig
from baselines.ppo.policy import PpoPolicy
from baselines.ppo.training import PpoTrainer
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.envs.delay_env import DelayGraphVectorEnv
from deepkoco.envs.estimator_wrapper import VectorEstimatorWrapper
from deepkoco.envs.unit_env import UnitEnv
from deepkoco.output.whole_file import write_whole_text
from deepkoco.unit import UnitSpec, make_unit

SYSTEM = "pendulum"  # the disk of the thesis, driven by a voltage; its unstable pole is at 11 rad/s
EPISODE_STEPS = 250  # of a training, at 50 Hz
UNIT_STEPS = 300  # of an episode on the unit, 6 s
UPRIGHT = 0.35  # an angle from upright up to this counts as upright [rad]
HISTORY = 5  # past observations and actions of a stack: 100 ms, longer than both delays together
SPREAD = 0.1  # standard deviation of a delay, as a share of its mean


@dataclass(frozen=True)
class Delays:
    """Mean delays of the unit, and of the simulations that know them.

    Attributes:
        sensing: From a measurement to the agent [s].
        actuation: From the agent to the motor [s].
    """

    sensing: float = 0.05
    actuation: float = 0.02

    def laws(self) -> dict[str, Any]:
        """Delays of a simulation, every message with one of its own."""
        means = {"sensing_delay": self.sensing, "actuation_delay": self.actuation}
        return {k: {"law": "gaussian", "loc": mean, "scale": SPREAD * mean} for k, mean in means.items()}

    def effects(self) -> dict[str, Any]:
        """Delays of the unit."""
        means = {"sensing_delay": self.sensing, "actuation_delay": self.actuation}
        return {k: {"delay": {"mean": mean, "sd": SPREAD * mean}} for k, mean in means.items()}


@dataclass(frozen=True)
class Method:
    """What a policy sees, in its simulation and on the unit.

    Attributes:
        sees: Settings of the simulation, and of the unit where it has them.
        delays: Whether the simulation has the delays and the noise of the sensors.
        on_unit: Label -> the estimator that stands between the unit and the policy, or None.
    """

    on_unit: Mapping[str, str | None]
    sees: Mapping[str, Any] = field(default_factory=dict)
    delays: bool = False


STACK = {"observation_history": HISTORY, "action_history": HISTORY}
METHODS = {
    "full_state": Method(
        {"full state": None, "full state, filtered": "filtered", "full state, predicted": "predicted"}
    ),
    "stacked": Method({"stacked": None}, STACK),
    "stacked_delays": Method({"stacked, simulated delays": None}, STACK, True),
    "filtered": Method({"filtered": "filtered"}, {"estimator": "filtered"}, True),
    "predicted": Method({"predicted": "predicted"}, {"estimator": "predicted"}, True),
}


def make_simulation(method: Method, delays: Delays) -> Callable[[int, int], VectorEnv]:
    """The factory of the environments in which a method is trained.

    Args:
        method: What the policy sees.
        delays: Of the unit.
    """
    known = {"noise": True, **delays.laws()} if method.delays else {}

    def make(count: int, seed: int) -> VectorEnv:
        return DelayGraphVectorEnv(
            count, EPISODE_STEPS, system=SYSTEM, action_units="physical", **known, **method.sees
        )

    return make


def hidden_unit(delays: Delays, seed: int) -> UnitSpec:
    """The unit: other parameters than the simulations have, joints that stick, and the delays.

    Args:
        delays: Its delays.
        seed: Of noise and jitter.
    """
    nominal = {"mass": 0.0509, "viscous": 1.43e-5, "motor_constant": 0.0333, "coulomb": 9.75e-4}
    factors = {"mass": 1.03, "viscous": 1.2, "motor_constant": 0.97, "coulomb": 1.1}
    return make_unit(
        SYSTEM,
        parameters={name: nominal[name] * factor for name, factor in factors.items()},
        effects=delays.effects(),
        seed=seed,
    )


def upright_shares(
    policy: PpoPolicy, method: Method, estimator: str | None, delays: Delays, seeds: Sequence[int], clock: str
) -> list[float]:
    """Share of the second half of each episode on the unit in which the pendulum was upright.

    Args:
        policy: What acts.
        method: What it sees.
        estimator: What stands between the unit and the policy.
        delays: Of the unit.
        seeds: One episode for each; of its start, noise and jitter.
        clock: Of the unit, ``simulated`` or ``wall``.
    """
    history = {name: size for name, size in method.sees.items() if name.endswith("_history")}

    def make(seed: int) -> UnitEnv:
        return UnitEnv(hidden_unit(delays, seed), clock, UNIT_STEPS + 1, **history)

    envs: VectorEnv = SyncVectorEnv([lambda seed=seed: make(seed) for seed in seeds])
    if estimator is not None:
        envs = VectorEstimatorWrapper(
            envs, estimator, actuation_delay=delays.actuation, control_rate=float(make(0).task.control_rate)
        )
    angles = []
    observation, _ = envs.reset(seed=list(seeds))
    for _ in range(UNIT_STEPS):
        actions = policy.act(observation.astype(np.float64)).astype(np.float32)
        observation, *_, info = envs.step(actions)
        angles.append(np.abs(info["angle_from_upright"]))
    envs.close()
    return (np.array(angles[UNIT_STEPS // 2 :]) <= UPRIGHT).mean(0).tolist()


def run(
    name: str, seed: int, delays: Delays, episodes: int, wall_episodes: int, training: int
) -> dict[str, Any]:
    """Train one policy and run it on the unit.

    Args:
        name: A name of `METHODS`.
        seed: Of the run.
        delays: Of the unit.
        episodes: Episodes on the unit in virtual time.
        wall_episodes: Episodes on the unit in real time.
        training: Episodes of the training.

    Returns:
        Costs and shares by label.
    """
    method = METHODS[name]
    config = PpoConfig(
        total_episodes=training, discount=0.99, divergence_limit=0.01, reference_episodes=0,
        final_evaluation_episodes=100,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        trainer = PpoTrainer(make_simulation(method, delays), config, seed, Path(folder))
        last = trainer.run()
        policy = trainer.policy
    training_seconds = time.process_time()
    first = derive_seed(seed, Purpose.FINAL_EVALUATION)
    shares, wall = {}, {}
    for label, estimator in method.on_unit.items():
        seeds = [(first + i) % 2**31 for i in range(episodes)]
        shares[label] = upright_shares(policy, method, estimator, delays, seeds, "simulated")
        alone = [
            upright_shares(policy, method, estimator, delays, [s], "wall") for s in seeds[:wall_episodes]
        ]
        wall[label] = [share for shares_of_one in alone for share in shares_of_one]
    return {
        "cost": last["evaluation/cost"],
        "upright": shares,
        "upright_in_real_time": wall,
        "training_cpu_seconds": training_seconds,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Train and evaluate once and write the result as JSON; returns the exit status."""
    parser = argparse.ArgumentParser(description="Train one policy and run it on a unit with delays.")
    parser.add_argument("method", choices=list(METHODS))
    parser.add_argument("seed", type=int)
    parser.add_argument("out", type=Path, help="new file")
    parser.add_argument("--sensing", type=float, default=Delays.sensing, help="mean sensing delay [s]")
    parser.add_argument("--actuation", type=float, default=Delays.actuation, help="mean actuation delay [s]")
    parser.add_argument("--episodes", type=int, default=40)
    parser.add_argument("--wall-episodes", type=int, default=0)
    parser.add_argument("--training", type=int, default=1920, help="episodes of the training")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    delays = Delays(args.sensing, args.actuation)
    found = run(args.method, args.seed, delays, args.episodes, args.wall_episodes, args.training)
    write_whole_text(args.out, json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
