"""Plug flow: what leaves a pipe is what entered it when the flow since then had swept its volume.

The delay tau of a pipe of volume V depends on its flow q, and with it on states and actions:

    integral of q from t - tau(t) to t = V.

A connection of the graph cannot have such a delay, because timing is drawn before anything is computed. A node can: its
state is the fluid. The pipe holds volume elements, newest first, that each keep the value with which they entered
(a temperature, a concentration, a time). Pushing fluid in at one end displaces the same volume at the other. No time
is involved, so the delay is exact for whatever flow, also where it changes or stands still.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class PipeFluid(NamedTuple):
    """What is in a pipe, newest element first.

    Element i takes the volume from edges[i - 1] (0 for the first) to edges[i], measured from the inlet. Elements
    beyond the oldest are empty: their edge is the volume of the pipe, too.

    Attributes:
        edges: (B, N) never decreasing, the last one is the volume of the pipe [m3].
        values: (B, N, C) what each element carries, per unit of volume.
    """

    edges: Tensor
    values: Tensor


class Displaced(NamedTuple):
    """What a push has brought to the outlet.

    Attributes:
        content: (B, C) sum over the displaced volume of value times volume.
        mean: (B, C) content by volume; where nothing moved, the value at the outlet.
    """

    content: Tensor
    mean: Tensor


def displaced_content(fluid: PipeFluid, inflow: Tensor, volume: Tensor) -> tuple[Tensor, Tensor]:
    """What an inflow (B,) [m3] will push out, of the fluid that is in the pipe and of itself.

    Args:
        fluid, inflow, volume: As for `push_fluid`.

    Returns:
        The content (B, C) of the fluid that leaves, and how much of the inflow does so too, (B,) [m3].
    """
    limit = torch.as_tensor(volume, dtype=inflow.dtype).expand(len(inflow))[:, None]
    beyond = (torch.cat([inflow[:, None], fluid.edges + inflow[:, None]], 1) - limit).clamp_min(0.0)
    gone = beyond[:, 1:] - beyond[:, :-1]
    return (gone[..., None] * fluid.values).sum(1), beyond[:, 0]


def fill_pipe(value: Tensor, volume: Tensor, cells: int) -> PipeFluid:
    """A pipe full of one fluid.

    Args:
        value: (B, C).
        volume: Of the pipe, a scalar or (B,) [m3].
        cells: Volume elements that it holds at least.

    Returns:
        Room for 2 cells + 1 elements: see `push_fluid`.
    """
    room = 2 * cells + 1
    edges = torch.as_tensor(volume, dtype=value.dtype).expand(len(value))[:, None].expand(-1, room)
    return PipeFluid(edges.clone(), value[:, None].expand(-1, room, -1).clone())


def push_fluid(
    fluid: PipeFluid, inflow: Tensor, value: Tensor, volume: Tensor, cells: int
) -> tuple[PipeFluid, Displaced]:
    """Push fluid into a pipe.

    Exact where the value is constant over the inflow. An inflow that fits with the newest element into V / cells is
    mixed with it, else a slow flow would need elements without end. Any two neighbours then hold more than V / cells
    together, so 2 cells elements fill the pipe: what is in the pipe has a resolution of V / cells, and of one push
    where that is more. What goes in less what comes out is always what the pipe holds more.

    Args:
        fluid: As `fill_pipe` made it.
        inflow: (B,) at least 0, also more than the pipe holds [m3].
        value: (B, C) of the inflow.
        volume: As for `fill_pipe`.
        cells: As for `fill_pipe`.

    Returns:
        What is in the pipe then, and what has been displaced.
    """
    limit = torch.as_tensor(volume, dtype=value.dtype).expand(len(value))[:, None]
    old, own = displaced_content(fluid, inflow, volume)
    content = old + own[:, None] * value
    held = torch.cat([value[:, None], fluid.values], 1)
    kept = torch.minimum(torch.cat([inflow[:, None], fluid.edges + inflow[:, None]], 1), limit)
    # The newest element before, as far as it is still in the pipe, and what has come.
    together, new = kept[:, 1], kept[:, 0]
    share = torch.where(together > 0.0, new / torch.where(together > 0.0, together, 1.0), 1.0)[:, None]
    mixed = torch.cat([(held[:, 1] + share * (value - held[:, 1]))[:, None], held[:, 2:]], 1)
    joins = (together * cells <= limit[:, 0])[:, None]
    after = PipeFluid(
        torch.where(joins, kept[:, 1:], kept[:, :-1]), torch.where(joins[..., None], mixed, held[:, :-1])
    )
    # What rounding leaves of an inflow: of much less than the pipe holds, little or nothing.
    moved = (fluid.edges[:, -1:] + inflow[:, None] - limit).clamp_min(0.0)
    moves = moved > 0.0
    mean = content / torch.where(moves, moved, 1.0)
    return after, Displaced(content, torch.where(moves, mean, outlet_value(fluid)))


def outlet_value(fluid: PipeFluid) -> Tensor:
    """Value (B, C) of the oldest element, which leaves next."""
    begins = torch.cat([torch.zeros_like(fluid.edges[:, :1]), fluid.edges[:, :-1]], 1)
    end = fluid.edges[:, -1:]
    oldest = (fluid.edges >= end) & (begins < end)
    return torch.where(oldest[..., None], fluid.values, 0.0).sum(1)


def pipe_content(fluid: PipeFluid) -> Tensor:
    """Sum (B, C) over the pipe of value times volume."""
    begins = torch.cat([torch.zeros_like(fluid.edges[:, :1]), fluid.edges[:, :-1]], 1)
    return ((fluid.edges - begins)[..., None] * fluid.values).sum(1)


def swept_time(volumes: Tensor, lengths: Tensor | float, volume: Tensor) -> Tensor:
    """Time back to when the flow since then has swept a volume: the delay of a pipe from the flow through it.

    Args:
        volumes: (B, K) swept in the last intervals, newest first [m3].
        lengths: Of the intervals, one or (B, K) [s].
        volume: Of the pipe, a scalar or (B,) [m3].

    Returns:
        (B,) [s]; where the volumes do not fill the pipe, the sum of all lengths.
    """
    left = torch.as_tensor(volume, dtype=volumes.dtype).expand(len(volumes))
    spans = torch.as_tensor(lengths, dtype=volumes.dtype).expand(volumes.shape)
    total = torch.zeros_like(left)
    for swept, length in zip(volumes.unbind(1), spans.unbind(1), strict=True):
        moves = swept > 0.0
        share = torch.where(moves, left / torch.where(moves, swept, 1.0), torch.where(left > 0.0, 1.0, 0.0))
        total = total + length * share.clamp(0.0, 1.0)
        left = (left - swept).clamp_min(0.0)
    return total
