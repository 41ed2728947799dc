"""Play between a joint and its sensors: the output follows once the joint has crossed the play."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.fit.simulate.nodes import Nodes
from deepkoco.systems.dry_friction import Levels
from deepkoco.systems.effects.hysteresis import SETTLED

TOUCH = 1.0 - 1e-9  # share of the play from which on the joint touches its output


def behind_play(nodes: Nodes, play: Levels) -> Nodes:
    """What sensors behind a play see of simulated states.

    y_k = min(max(y_{k-1}, q_k - w), q_k + w). While the joint crosses the play the output rests.

    Args:
        nodes: Simulated states, J angles and then J speeds.
        play: Per joint, half of the play w, scalar or (L,), in the joint's unit; None for none.

    Source: Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (1996).
    """
    value, left, right = list(nodes.value), list(nodes.left), list(nodes.right)
    for j, width in enumerate(play):
        if width is None:
            continue
        s = j + len(play)
        angle, speed = nodes.value[j], nodes.value[s]
        output, touches = _followed(angle, speed, width)
        value[j], value[s] = output, torch.where(touches, speed, 0.0)
        left[j], right[j] = (torch.where(part, x, 0.0) for part, x in _ends(touches, nodes, j))
        left[s], right[s] = (torch.where(part, x, 0.0) for part, x in _ends(touches, nodes, s))
    return Nodes(tuple(value), tuple(left), tuple(right))


def _followed(angle: Tensor, speed: Tensor, width: Tensor) -> tuple[Tensor, Tensor]:
    """Output (n + 1, W, L), and whether the joint carries it along."""
    output = torch.empty_like(angle)
    reach = torch.broadcast_to(width, angle[0].shape)
    last = angle[0] - torch.minimum(torch.maximum(SETTLED * speed[0], -reach), reach)
    for k, now in enumerate(angle):
        last = torch.minimum(torch.maximum(last, now - reach), now + reach)
        output[k] = last
    return output, (angle - output) * torch.sign(speed) >= TOUCH * reach


def _ends(touches: Tensor, nodes: Nodes, state: int) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    return (touches[:-1], nodes.left[state]), (touches[1:], nodes.right[state])
