"""Tasks of the study, as a user writes them."""

import torch

from deepkoco import Task


class Swing(Task):
    """Swing the pole of the cart up and keep the cart in the middle of its rail."""

    control_rate = 25.0
    starts = {"pole": (-0.3, 0.3)}  # noqa: RUF012
    limits = {"cart": (-2.0, 2.0)}  # noqa: RUF012
    leaving_cost = 200.0

    def cost(self, scene, state, commands, parameters=None):
        cart, pole, _, pole_speed = state.unbind(-1)
        up = 1.0 + torch.cos(pole)
        return up + 0.2 * cart**2 + 0.01 * pole_speed**2 + 0.001 * commands[..., 0] ** 2


class Turn(Task):
    """Turn the motor's load to angle zero and stay there."""

    control_rate = 25.0
    starts = {"joint 1": (-3.0, 3.0)}  # noqa: RUF012

    def cost(self, scene, state, commands, parameters=None):
        angle, speed = state[..., 0], state[..., 1]
        return angle**2 + 1e-3 * speed**2 + 1e-3 * commands[..., 0] ** 2


class Reach(Task):
    """Bring the arm of two joints into a posture, and hold it there against gravity."""

    control_rate = 20.0
    command_limits = (6.0, 2.2)
    starts = {"q_j1": (-0.6, 0.6), "q_j2": (-0.6, 0.6)}  # noqa: RUF012
    speed_limit = 20.0

    def cost(self, scene, state, commands, parameters=None):
        first, second, speed_1, speed_2 = state.unbind(-1)
        away = 2.0 - torch.cos(first - 0.5) - torch.cos(second + 0.7)
        return 3.0 * away + 0.005 * (speed_1**2 + speed_2**2)
