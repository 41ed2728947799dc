"""Channels whose measurements are older than those of the others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import reduce

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import PlacedEffect
from deepkoco.systems.parameter import Parameters

NAME = "channel_delay"  # of the effect


def channel_delays(effects: Iterable[PlacedEffect], parameters: Parameters) -> dict[int, Tensor]:
    """Delays of the channels at which the effect acts: channel -> (...) [s]."""
    own = [(placed.index, f"{placed.name}.delay") for placed in effects if placed.effect.name == NAME]
    return {channel: parameters[name] for channel, name in own if name in parameters}


def latest(delays: Mapping[int, Tensor]) -> Tensor:
    """Longest of the delays (...) [s]; 0 where there is none."""
    return reduce(torch.maximum, delays.values(), torch.zeros((), dtype=torch.float64))


def ahead_of_latest(delays: Mapping[int, Tensor], channels: int) -> dict[int, Tensor]:
    """Time by which each channel shows a later state than the latest channel: channel -> (...) [s].

    Args:
        delays: Channel -> its delay [s].
        channels: Number N of all channels.

    Returns:
        Those of the N channels that are ahead.
    """
    most = latest(delays)
    zero = torch.zeros((), dtype=torch.float64)
    ahead = {c: most - delays.get(c, zero) for c in range(channels)}
    return {c: time for c, time in ahead.items() if bool((time > 0.0).any())}
