"""A pool of delay traces: schedules that many environments and episodes share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.envs.settings import SettingsError, check_range
from deepkoco.graph import ComputationGraph, Graph, draw_timing, make_delay
from deepkoco.graph.delay import RecordedDelays
from deepkoco.graph.timing.computation_graph import concatenate

Ranges = Mapping[str, tuple[float, float]]
Delays = Mapping[str, Any]
MIN_TRACES = 8  # traces of a pool with random delays, so that one environment need not draw at every reset

LISTS = ("law", "samples", "components", "weights", "times", "delays")  # of a law, where a list is no range


class DelayTraces:
    """Schedules drawn together, of which every episode takes one.

    A schedule is far larger than the state of an environment, and finding the slots common to many takes
    time, so neither is done for each episode. An environment takes a trace that has not been used yet; when
    they are used up, a reset of all environments draws new ones. Where there are more environments than
    traces, or a part of them starts anew after the last unused trace, traces are taken at random.

    Args:
        graph: The graph.
        steps: Supervisor steps of a trace.
        batch: Environments B.
        most: Largest number of traces.
        ranges: Name -> (low, high): numbers drawn uniformly for each trace.
        delays: From these draws, each (R,), the delays by connection key or node name, as `draw_timing` takes
            them; None takes the draws themselves, in seconds.
        recorded: Recordings played in the place of the laws of their channels.
    """

    def __init__(
        self,
        graph: Graph,
        steps: int,
        batch: int,
        most: int,
        ranges: Ranges,
        delays: Callable[[Mapping[str, Tensor]], Delays] | None = None,
        recorded: RecordedDelays | None = None,
    ) -> None:
        self.graph, self.steps, self.batch = graph, steps, batch
        self.ranges = dict(ranges)
        self._delays = delays
        self._recorded = recorded
        self.constant = not self.ranges and recorded is None and graph.constant
        self.most = most
        self.rows = 1 if self.constant else min(most, max(batch, MIN_TRACES))
        self.draws: dict[str, Tensor] = {}
        self._unused: np.ndarray | None = None

    def take(
        self, generator: torch.Generator, mask: np.ndarray | None, fresh: bool
    ) -> tuple[ComputationGraph | None, np.ndarray]:
        """Give traces to the environments that start anew.

        Args:
            generator: Where the draws come from.
            mask: (B,) bool, who starts; None: all.
            fresh: Draw new traces in any case; all environments start.

        Returns:
            The new pool, None where it stays, and the rows (B,) of those that start; others have row 0.
        """
        rows = np.zeros(self.batch, dtype=np.int64)
        if self.constant:
            if self._unused is not None:
                return None, rows
            self._unused = np.zeros(0, dtype=np.int64)
            return draw_timing(self.graph, generator, self.steps, 1), rows
        starting = np.arange(self.batch) if mask is None else np.flatnonzero(mask)
        count = len(starting)
        used_up = self._unused is None or (count <= self.rows and count > len(self._unused))
        timing = None
        if fresh or (mask is None and used_up):
            timing = self._draw(generator)
        assert self._unused is not None
        if count <= len(self._unused):
            rows[starting], self._unused = self._unused[:count], self._unused[count:]
        else:
            chosen = torch.randint(self.rows, (count,), generator=generator).numpy()
            # Neighbours with one schedule share their work; the traces are in no order of their own.
            rows[starting] = np.sort(chosen)
        return timing, rows

    def take_own(
        self, seeds: Mapping[int, int], generator: torch.Generator, mask: np.ndarray | None
    ) -> tuple[ComputationGraph | None, np.ndarray]:
        """Give some environments a trace that follows from a seed of their own.

        It is that of a batch of one whose traces are drawn with this seed. Where more environments are seeded than
        traces may be held, or only a part of them starts, they share traces: the same seed has the same trace.

        Args:
            seeds: By place in the batch.
            generator: Where the draws of the others come from.
            mask: (B,) bool, who starts; None: all.

        Returns:
            As :meth:`take`.
        """
        timing, rows = self.take(generator, mask, fresh=mask is None)
        if self.constant:
            return timing, rows
        if timing is None:
            rows[list(seeds)] = [seed % self.rows for seed in seeds.values()]
            return timing, rows
        if len(set(seeds.values())) > self.most:
            seeds = {place: seed % self.most for place, seed in seeds.items()}
        different = sorted(set(seeds.values()))
        parts, draws = [timing], [self.draws]
        for seed in different:
            drawn, own = self._drawn(torch.Generator().manual_seed(seed), min(self.most, MIN_TRACES))
            parts.append(own.take(np.array([0])))
            draws.append({name: value[:1] for name, value in drawn.items()})
        self.draws = {name: torch.cat([own[name] for own in draws]) for name in self.ranges}
        rows[list(seeds)] = [self.rows + different.index(seed) for seed in seeds.values()]
        return concatenate(self.graph, parts), rows

    def _draw(self, generator: torch.Generator) -> ComputationGraph:
        self.draws, timing = self._drawn(generator, self.rows)
        self._unused = np.arange(self.rows)
        return timing

    def _drawn(self, generator: torch.Generator, rows: int) -> tuple[dict[str, Tensor], ComputationGraph]:
        """Draws from the ranges, (R,) each, and R traces."""
        draws = {
            name: low + (high - low) * torch.rand(rows, generator=generator, dtype=torch.float64)
            for name, (low, high) in self.ranges.items()
        }
        delays = {k: v.numpy() for k, v in draws.items()} if self._delays is None else self._delays(draws)
        timing = draw_timing(self.graph, generator, self.steps, rows, delays, rows, traces=self._recorded)
        return draws, timing


def law_ranges(name: str, law: Mapping[str, Any], known: set[str]) -> dict[str, tuple[float, float]]:
    """Ranges in the description of a delay law, by ``name.number``.

    Args:
        name: Connection or node whose delay it is.
        law: Description in which pairs (low, high) stand for some of the numbers.
        known: Names of connections and nodes.

    Raises:
        SettingsError: The name is not known, or a range is none.
        DelayError: The law is not known, or one end of its ranges is no delay.
    """
    if name not in known:
        raise SettingsError(f'randomize: "{name}" is none of {", ".join(sorted(known))}')
    ranges = {}
    for key, value in law.items():
        if key in LISTS or not isinstance(value, (tuple, list)):
            continue
        check_range(f"{name}.{key}", value, 0.0, np.inf, "")
        ranges[f"{name}.{key}"] = (float(value[0]), float(value[1]))
    for end in (0, 1):
        make_delay({key: ranges[f"{name}.{key}"][end] if f"{name}.{key}" in ranges else value
                    for key, value in law.items()})  # fmt: skip
    return ranges
