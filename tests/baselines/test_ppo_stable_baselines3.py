"""The update and the advantages of PPO are those of stable-baselines3: needs the bench extra."""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from tracking import Tracking

from baselines.ppo.collection import Collector
from baselines.ppo.config import PpoConfig
from baselines.ppo.learner import PpoLearner, Samples
from baselines.ppo.networks import ActorCritic
from baselines.ppo.scaling import ScaledRewards

pytestmark = pytest.mark.bench
sb3 = pytest.importorskip("stable_baselines3", reason="needs the bench extra: make bench")

STEPS, ENVIRONMENTS, N, M = 32, 4, 3, 2
CONFIG = PpoConfig(
    environments=ENVIRONMENTS, steps=STEPS, epochs=4, minibatch=48, hidden=(16, 16), learning_rate=3e-3,
    discount=0.9, trace_decay=0.8, entropy_weight=0.01, scale_observations=False, scale_rewards=False,
)  # fmt: skip


def their_model(config, size, action_size, **changes):
    """Their PPO on an environment of which only the spaces count."""
    import gymnasium

    class Spaces(gymnasium.Env):
        observation_space = spaces.Box(-10, 10, (size,), np.float32)
        action_space = spaces.Box(-1, 1, (action_size,), np.float32)

        def reset(self, *, seed=None, options=None):
            return np.zeros(size, np.float32), {}

        def step(self, action):
            return np.zeros(size, np.float32), 0.0, False, False, {}

    options = {
        "learning_rate": config.learning_rate, "n_steps": config.steps, "batch_size": config.minibatch,
        "n_epochs": config.epochs, "gamma": config.discount, "gae_lambda": config.trace_decay,
        "clip_range": config.ratio_clip, "ent_coef": config.entropy_weight, "vf_coef": config.value_weight,
        "max_grad_norm": config.gradient_limit, "target_kl": config.divergence_limit,
        "policy_kwargs": {"net_arch": list(config.hidden)}, "seed": 0, "device": "cpu",
    }  # fmt: skip
    env = sb3.common.vec_env.DummyVecEnv([Spaces] * config.environments)
    model = sb3.PPO("MlpPolicy", env, **(options | changes))
    model._setup_learn(1)
    model.set_logger(sb3.common.logger.Logger(None, []))
    return model


def take_over(networks, policy):
    """Give ours the weights of theirs, and say which of theirs each is."""
    extractor = policy.mlp_extractor
    pairs = [(networks.log_sigma, policy.log_std)]
    for ours, hidden, last in (
        (networks.actor, extractor.policy_net, policy.action_net),
        (networks.critic, extractor.value_net, policy.value_net),
    ):
        pairs += zip(ours.parameters(), [*hidden.parameters(), *last.parameters()], strict=True)
    with torch.no_grad():
        for own, their in pairs:
            own.copy_(their)
    return pairs


@pytest.mark.parametrize("limit", [None, 1e-3])
def test_one_update_gives_the_same_weights(limit):
    config = CONFIG if limit is None else PpoConfig(**{**CONFIG.__dict__, "divergence_limit": limit})
    model = their_model(config, N, M)
    networks = ActorCritic(N, -np.ones(M), np.ones(M), config)
    pairs = take_over(networks, model.policy)
    random = torch.Generator().manual_seed(1)
    # Their rollout has steps before environments, their minibatches environments before steps.
    observations = torch.randn(ENVIRONMENTS * STEPS, N, generator=random)
    with torch.no_grad():
        mean, values = networks.actor(observations), networks.critic(observations)[:, 0]
        actions = networks.explore(mean, torch.randn(mean.shape, generator=random))
        samples = Samples(
            observations, actions, networks.density(mean, actions), values,
            *(torch.randn(len(values), generator=random) for _ in range(2)),
        )  # fmt: skip
    buffer = model.rollout_buffer
    for name, value in (
        ("observations", samples.observations), ("actions", samples.actions), ("log_probs", samples.densities),
        ("values", samples.values), ("advantages", samples.advantages), ("returns", samples.returns),
    ):  # fmt: skip
        array = value.numpy().reshape(ENVIRONMENTS, STEPS, *value.shape[1:])
        getattr(buffer, name)[:] = array.swapaxes(0, 1)
    buffer.full = True
    np.random.seed(5)  # noqa: NPY002 - what they draw from
    orders = [torch.from_numpy(np.random.permutation(len(values))) for _ in range(config.epochs)]  # noqa: NPY002
    np.random.seed(5)  # noqa: NPY002 - what they draw from
    model.train()
    before = [own.detach().clone() for own, _ in pairs]
    learner = PpoLearner(networks, config)
    logged = learner.update(samples, orders)
    if limit is not None:
        assert 0 < learner.updates < config.epochs * 3
    for old, (own, their) in zip(before, pairs, strict=True):
        assert (own - old).abs().max() > 1e-4  # what is compared has moved
        torch.testing.assert_close(own, their, rtol=1e-4, atol=2e-6)
    theirs = model.logger.name_to_value
    assert logged["ppo/explained_variance"] == pytest.approx(theirs["train/explained_variance"], abs=1e-5)
    assert logged["ppo/sigma"] == pytest.approx(theirs["train/std"], rel=1e-5)
    assert logged["loss/policy"] == pytest.approx(theirs["train/policy_gradient_loss"], abs=1e-5)
    assert logged["loss/value"] == pytest.approx(theirs["train/value_loss"], rel=1e-4)
    assert logged["ppo/clipped"] == pytest.approx(theirs["train/clip_fraction"], abs=1e-6)


@pytest.mark.parametrize("terminates", [False, True])
def test_advantages_at_ends_of_episodes_are_the_same(terminates):
    """Their rollout adds the value behind a time limit to the last reward, ours to the value of what follows."""
    lengths = [3, 7, 5, 40]
    envs = Tracking(ENVIRONMENTS, mode=AutoresetMode.SAME_STEP, lengths=lengths, terminates=terminates)
    model = their_model(CONFIG, 1, 1)
    networks = ActorCritic(1, np.array([-2.0]), np.array([2.0]), CONFIG)
    take_over(networks, model.policy)
    collector = Collector(envs, networks, ScaledRewards(ENVIRONMENTS, 0.9, 10.0, False), CONFIG)
    collector.start(0)
    rollout, samples = collector.run(torch.Generator().manual_seed(0))
    assert rollout.ended.sum() == 3
    buffer = model.rollout_buffer
    buffer.reset()
    starts = np.ones(ENVIRONMENTS)
    following = torch.from_numpy(rollout.following).float()
    with torch.no_grad():
        values, after = (
            networks.critic(seen)[..., 0] for seen in (torch.from_numpy(rollout.observations), following)
        )
    rewards = rollout.rewards + CONFIG.discount * after.numpy() * rollout.truncated
    for t in range(STEPS):
        buffer.add(
            rollout.observations[t],
            np.zeros((ENVIRONMENTS, 1)),
            rewards[t],
            starts,
            values[t],
            torch.zeros(4),
        )
        starts = rollout.ended[t]
    buffer.compute_returns_and_advantage(after[-1], starts)
    np.testing.assert_allclose(samples.advantages.reshape(STEPS, -1), buffer.advantages, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(samples.returns.reshape(STEPS, -1), buffer.returns, rtol=1e-4, atol=1e-5)
