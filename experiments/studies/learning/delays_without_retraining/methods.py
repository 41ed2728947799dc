"""The policies of the study in a batch of environments, and what an episode costs them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv

from deepkoco.agent.agent import VectorAgent, load_agent
from deepkoco.agent.collection import BatchController, collect_episodes, episode_costs
from deepkoco.agent.delayed_agent import DelayedAgent
from deepkoco.agent.delayed_policy import DelayedPolicy
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.agent.stored_controller import StoredController, read_controller
from deepkoco.envs.delay_line import ExpectedDelays
from deepkoco.envs.vector_delay_wrapper import VectorDelayWrapper
from deepkoco.koopman.forward_model import ForwardModel
from deepkoco.runs.agents import load_controller
from deepkoco.runs.delayed import forward_model_of
from deepkoco.runs.environments import make_factory
from experiments.studies.learning.delays_without_retraining import cart_pole, rivals
from experiments.studies.learning.delays_without_retraining.laws import Law

CALM = {"pendulum": 0.5, "cart_pole": 0.1}
"""R~ of the policy among delays; for the pendulum chosen on other start states, from 0.01, 0.3, 1 and 3."""
START_STATES = 101
"""Index of the start states of the study; others were used while it was written."""
SHIFTED = "undelayed from the first arrival"
METHODS = (
    "no compensation",
    "no compensation, calm",
    "latent, time stamps",
    "observation, time stamps",
    "observation, law",
    "observation, both",
    "latent, law",
    "latent, both",
    SHIFTED,
    "random",
)
NOT_ON = {
    "pendulum": ("latent, law", "latent, both"),
    "cart_pole": (
        "no compensation, calm",
        "observation, time stamps",
        "observation, law",
        "observation, both",
    ),
}


@dataclass(frozen=True)
class Policy:
    """A policy that was trained, or fitted, without delays.

    Attributes:
        task: "pendulum" or "cart_pole".
        seed: Of its training.
        stored: Model, planner and limits.
        forward: Predicts observations; None on the cart-pole, whose model is linear.
        make: Makes its environments from (count).
    """

    task: str
    seed: int
    stored: StoredController
    forward: ForwardModel | None
    make: Callable[[int], VectorEnv]


def pendulum(work: Path, seed: int) -> Policy:
    """The DeepKoCo policy of the pendulum."""
    folder = rivals.undelayed_run(work, seed)
    make = make_factory(rivals.task(), "none")
    forward = forward_model_of(folder, rivals.STEP, seed)
    return Policy("pendulum", seed, read_controller(folder), forward, lambda count: make(count, seed))


def cart(seed: int) -> Policy:
    """The EDMDc policy of the cart-pole."""
    return Policy("cart_pole", seed, cart_pole.fit_policy(seed), None, cart_pole.make_envs)


def costs_of(policy: Policy, law: Law, method: str, episodes: int) -> np.ndarray | None:
    """Costs of episodes (n,), from the same start states for all laws and methods; None: a method has no such law."""
    if method in NOT_ON[policy.task] or (method == SHIFTED and law.shift is None):
        return None
    inner = policy.make(episodes)
    envs = VectorDelayWrapper(inner, law.actuation, law.sensing, in_order=law.in_order)
    agent: BatchController
    if method == "random":
        agent, run = Random(inner, policy.seed), inner
    elif method == SHIFTED:
        assert law.shift is not None
        agent, run = Late(_undelayed(policy, episodes), law.shift, len(policy.stored.action_low)), inner
    elif method.startswith("no compensation"):
        agent, run = _undelayed(policy, episodes, "calm" in method), envs
    else:
        agent, run = _compensated(policy, envs, method), envs
    costs = episode_costs(collect_episodes(run, agent, _start(policy.seed), record=False))
    envs.close()
    return costs


def rival_costs(folder: Path, agent: str, law: Law, episodes: int, seed: int) -> np.ndarray:
    """Costs of a retrained rival among delays, from the start states of the policy of the same seed."""
    envs = rivals.rival_envs(law)(episodes, seed)
    controller = (
        load_agent(folder, episodes) if agent == "deepkoco" else load_controller(agent, folder, episodes)
    )
    costs = episode_costs(collect_episodes(envs, controller, _start(seed), record=False))
    envs.close()
    return costs


class Random:
    """Uniform actions."""

    def __init__(self, envs: VectorEnv, seed: int) -> None:
        space = envs.single_action_space
        assert isinstance(space, spaces.Box)
        self._space, self._count, self._seed = space, envs.num_envs, seed
        self.reset()

    def reset(self) -> None:
        """Start anew."""
        self._rng = np.random.default_rng(self._seed)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions (B, M)."""
        return self._rng.uniform(self._space.low, self._space.high, (self._count, *self._space.shape))


class Late:
    """An agent that begins to act some steps late; until then zero acts."""

    def __init__(self, agent: VectorAgent, steps: int, actions: int) -> None:
        self._agent, self._steps, self._actions = agent, steps, actions
        self.reset()

    def reset(self) -> None:
        """Start anew."""
        self._agent.reset()
        self._waited = 0

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Actions (B, M)."""
        if self._waited == self._steps:
            return self._agent.act(observations)
        self._waited += 1
        return np.zeros((len(observations), self._actions))


def _start(seed: int) -> int:
    return derive_seed(seed, Purpose.FINAL_EVALUATION, START_STATES)


def _undelayed(policy: Policy, episodes: int, calm: bool = False) -> VectorAgent:
    stored = policy.stored
    planner = replace(stored.planner, increment_weight=CALM[policy.task]) if calm else stored.planner
    return VectorAgent(stored.model, planner, stored.action_low, stored.action_high, episodes)


def _compensated(policy: Policy, envs: VectorDelayWrapper, method: str) -> DelayedAgent:
    stored, told = policy.stored, method.split(", ")[1]
    expected = ExpectedDelays({"observation": 0.0}, 0.0) if told == "time stamps" else envs.expected_delays
    planner = replace(stored.planner, increment_weight=CALM[policy.task])
    forward = policy.forward if method.startswith("observation") else None
    delays = expected.sensing["observation"], expected.actuation
    policies = [
        DelayedPolicy(stored.model, planner, stored.action_low, stored.action_high, forward, *delays)
        for _ in range(envs.num_envs)
    ]
    return DelayedAgent(policies, measured=told != "law")
