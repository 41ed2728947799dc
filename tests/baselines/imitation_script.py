"""A teacher in a module, for nodes that get a process of their own."""

import torch


def steer(observations):
    """Against the angle and the speed."""
    return (-2.0 * observations[:, 1:2] - 0.5 * observations[:, 2:3]).clamp(-2.0, 2.0)


def observe(measured):
    """Cosine and sine of the angle, and the speed."""
    return torch.cat([torch.cos(measured[:, :1]), torch.sin(measured[:, :1]), measured[:, 1:2]], -1)
