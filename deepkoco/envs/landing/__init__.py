"""A quadrotor that lands on a moving, inclined deck: its graph, its agent's seat, and its environment."""

from deepkoco.envs.landing.landing_graph import LandingOptions, landing_graph, landing_start
from deepkoco.envs.landing.seat import LandingSeat

__all__ = ["LandingOptions", "LandingSeat", "landing_graph", "landing_start"]
