"""Noise without a memory: standard normal draws that follow from a key and a counter alone."""

from deepkoco.graph.model.noise import draw_keys, normal

__all__ = ["draw_keys", "normal"]
