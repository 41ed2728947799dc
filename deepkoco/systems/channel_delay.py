"""Channels whose measurements are older than those of the others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import reduce

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import PlacedEffect
from deepkoco.systems.parameter import Parameters

NAME = "channel_delay"  # of the effect at one channel
OF_SPEEDS = "speed_delay"  # of the effect on all channels of speeds


def channel_delays(
    effects: Iterable[PlacedEffect], parameters: Parameters, speeds: Sequence[int]
) -> dict[int, Tensor]:
    """Delays that effects give to channels: channel -> (...) [s].

    Args:
        effects: Those of a system.
        parameters: Named values.
        speeds: Channels that show speeds.
    """
    found: dict[int, Tensor] = {}
    for placed in effects:
        if placed.effect.name not in (NAME, OF_SPEEDS) or f"{placed.name}.delay" not in parameters:
            continue
        late = speeds if placed.effect.name == OF_SPEEDS else (placed.index,)
        found = sums(found, dict.fromkeys(late, parameters[f"{placed.name}.delay"]))
    return found


def sums(delays: Mapping[int, Tensor], more: Mapping[int, Tensor]) -> dict[int, Tensor]:
    """Delays of channels (...) [s] that have both of two kinds, or one."""
    return {
        c: delays[c] + more[c] if c in delays and c in more else delays[c] if c in delays else more[c]
        for c in dict.fromkeys((*delays, *more))
    }


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
