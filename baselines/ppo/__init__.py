"""PPO: rollouts of a policy in many environments at once, then a few epochs of minibatches on what they gave."""
