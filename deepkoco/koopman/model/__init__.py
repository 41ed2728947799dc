"""The torch model: encoder, cost, and the rollout of its latents."""
