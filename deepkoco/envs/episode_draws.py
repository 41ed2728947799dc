"""Draws of an episode: numbers from ranges and a delay trace, for each environment that starts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from gymnasium.utils import seeding
from torch import Tensor

from deepkoco.envs.delay_traces import DelayTraces
from deepkoco.graph import ComputationGraph

Ranges = Mapping[str, tuple[float, float]]


class EpisodeDraws:
    """Draws what a batch of environments needs when episodes start.

    Args:
        ranges: Name -> (low, high) of each number that is drawn.
        traces: The pool of delay traces; it draws the numbers of its own ranges.

    Attributes:
        values: What the environments have drawn for their episodes, (B,) by name.
    """

    def __init__(self, ranges: Ranges, traces: DelayTraces) -> None:
        self._ranges, self._traces = dict(ranges), traces
        self.values: dict[str, Tensor] = {}

    def draw(
        self,
        generator: torch.Generator,
        mask: np.ndarray | None,
        running: np.ndarray | None,
        new_traces: bool,
        own_seeds: Mapping[int, int],
    ) -> tuple[ComputationGraph | None, np.ndarray, dict[int, torch.Generator]]:
        """Draw for the environments that start.

        Args:
            generator: Where the draws come from.
            mask: (B,) bool, who starts; None: all.
            running: (B,) rows of the traces that run, where not all start.
            new_traces: Draw the pool of traces anew.
            own_seeds: By place in the batch, seeds of those that have one of their own.

        Returns:
            The new pool, None where it stays; the row (B,) of each environment; and the generators of those
            with a seed of their own, for what else they draw.
        """
        fresh = self._fresh(self._traces.batch, generator)
        # The traces have a stream of their own: how many are drawn changes nothing else of an episode.
        stream = torch.Generator().manual_seed(int(torch.randint(2**62, (), generator=generator)))
        own: dict[int, torch.Generator] = {}
        if own_seeds:
            seeds = {}
            for place, seed in own_seeds.items():
                own[place], seeds[place], drawn = self._single(seed)
                for name, value in drawn.items():
                    fresh[name][place] = value[0]
            timing, rows = self._traces.take_own(seeds, stream, mask)
        else:
            timing, rows = self._traces.take(stream, mask, new_traces)
        if mask is not None:
            assert running is not None
            rows = np.where(mask, rows, running)
            chosen = torch.from_numpy(mask)
            fresh = {name: torch.where(chosen, value, self.values[name]) for name, value in fresh.items()}
        timed = {name: value[torch.from_numpy(rows)] for name, value in self._traces.draws.items()}
        self.values = {name: timed[name] if name in timed else fresh[name] for name in self._ranges}
        return timing, rows, own

    def _fresh(self, batch: int, generator: torch.Generator) -> dict[str, Tensor]:
        """Draws (B,) from the ranges that say nothing about when things happen."""
        return {
            name: low + (high - low) * torch.rand(batch, generator=generator, dtype=torch.float64)
            for name, (low, high) in self._ranges.items()
            if name not in self._traces.ranges
        }

    def _single(self, seed: int) -> tuple[torch.Generator, int, dict[str, Tensor]]:
        """What a single environment with this seed draws, in its order: generator, seed of the trace, draws (1,)."""
        random, _ = seeding.np_random(seed)
        generator = torch.Generator().manual_seed(int(random.integers(2**62)))
        drawn = self._fresh(1, generator)
        return generator, int(torch.randint(2**62, (), generator=generator)), drawn
