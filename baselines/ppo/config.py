"""Hyper-parameters of PPO."""

from __future__ import annotations

from dataclasses import dataclass

from baselines.config import BaselineConfigError, check_positive


@dataclass
class PpoConfig:
    """PPO with a clipped ratio, and how a run is carried out.

    Source: Schulman et al. (2017), Proximal policy optimization algorithms, and the code that they published.
    """

    name: str = "ppo"
    """The algorithm."""
    total_episodes: int = 3200
    """Episodes of the run; it ends with the round in which they are reached."""
    environments: int = 64
    """B, environments stepped side by side."""
    steps: int = 200
    """T, steps of each environment between two updates; a round of episodes has one or more such rollouts."""
    epochs: int = 10
    """Passes over the samples of a rollout."""
    minibatch: int = 512
    """Samples of one step of Adam; the last of an epoch may have fewer."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of actor and critic, with tanh."""
    learning_rate: float = 1e-3
    """Step size of Adam."""
    final_learning_rate: float = 1.0
    """Share of the step size that is left at the end; it falls linearly with the episodes."""
    discount: float = 0.99
    """gamma, per step."""
    trace_decay: float = 0.95
    """lambda of the advantages: 0 trusts the values alone, 1 the rewards of the rollout alone."""
    ratio_clip: float = 0.2
    """epsilon: the ratio of new to old density gives no gradient further from 1 than this."""
    value_clip: float | None = None
    """Largest move of a value away from the one of the rollout that lowers the loss, in units of scaled rewards; none:
    no limit."""
    value_weight: float = 0.5
    """Weight of the squared error of the values."""
    entropy_weight: float = 0.0
    """Weight of the entropy of the actions before they are clipped."""
    gradient_limit: float = 0.5
    """Largest norm of the gradient of all weights; a longer one is scaled down."""
    divergence_limit: float | None = None
    """An update stops before a minibatch whose estimated KL divergence from the rollout's policy is above 1.5 times
    this; none: it never does."""
    scale_advantages: bool = True
    """Advantages of a minibatch have mean 0 and standard deviation 1."""
    scale_observations: bool = True
    """Observations are centred and scaled by their running moments."""
    scale_rewards: bool = True
    """Rewards are divided by the running standard deviation of their discounted sum."""
    observation_limit: float = 10.0
    """Scaled observations are clipped to this."""
    reward_limit: float = 10.0
    """Scaled rewards are clipped to this."""
    log_sigma: float = 0.0
    """Logarithm of the standard deviation of the actions before any update, for actions of [-1, 1]."""
    steps_ahead: bool = True
    """The policy acts inside of the executor where the environments can do that; false: every step is a call. The
    samples are the same up to rounding."""
    evaluation_every: int = 320
    """Episodes between two evaluations, each of which adds a row of metrics."""
    evaluation_episodes: int = 20
    """Noise-free episodes of an evaluation; 0 for none."""
    final_evaluation_episodes: int = 200
    """Noise-free episodes at the end of the run."""
    reference_episodes: int = 50
    """Start states of the final evaluation from which zero action, random episodes and EDMDc with DeepKoCo's planner
    are measured too; 0 for none."""
    checkpoint_episodes: int = 320
    """Episodes between two checkpoints."""

    def check(self) -> None:
        """Check the ranges.

        Raises:
            BaselineConfigError: Names the first value that is out of range and its remedy.
        """
        positive = (
            "total_episodes environments steps epochs minibatch learning_rate ratio_clip gradient_limit "
            "observation_limit reward_limit evaluation_every final_evaluation_episodes checkpoint_episodes"
        )
        check_positive(self, *positive.split())
        for name in ("value_clip", "divergence_limit"):
            if getattr(self, name) is not None:
                check_positive(self, name)
        for name in ("discount", "trace_decay", "final_learning_rate"):
            if not 0 <= getattr(self, name) <= 1:
                raise BaselineConfigError(f"{name} = {getattr(self, name)}; give a value in [0, 1]")
        for name in ("value_weight", "entropy_weight", "evaluation_episodes", "reference_episodes"):
            if not getattr(self, name) >= 0:
                raise BaselineConfigError(f"{name} = {getattr(self, name)}; give 0 or more")
        if not -20 <= self.log_sigma <= 2:
            raise BaselineConfigError(f"log_sigma = {self.log_sigma}; give a value in [-20, 2]")
        if any(width < 1 for width in self.hidden):
            raise BaselineConfigError(f"hidden = {list(self.hidden)}; give values above 0")
