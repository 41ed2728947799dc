"""Gymnasium environments on the delay graph."""

from deepkoco.envs.registration import ENVIRONMENTS, register_envs

register_envs()

__all__ = ["ENVIRONMENTS", "register_envs"]
