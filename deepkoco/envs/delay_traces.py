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

Ranges = Mapping[str, tuple[float, float]]
Delays = Mapping[str, Any]
MIN_TRACES = 8  # traces of a pool with random delays, so that one environment need not draw at every reset


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

    def _draw(self, generator: torch.Generator) -> ComputationGraph:
        self.draws = {
            name: low + (high - low) * torch.rand(self.rows, generator=generator, dtype=torch.float64)
            for name, (low, high) in self.ranges.items()
        }
        delays = (
            {k: v.numpy() for k, v in self.draws.items()}
            if self._delays is None
            else self._delays(self.draws)
        )
        self._unused = np.arange(self.rows)
        return draw_timing(
            self.graph, generator, self.steps, self.rows, delays, self.rows, traces=self._recorded
        )


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
        if key in ("law", "samples", "components", "weights") or not isinstance(value, (tuple, list)):
            continue
        check_range(f"{name}.{key}", value, 0.0, np.inf, "")
        ranges[f"{name}.{key}"] = (float(value[0]), float(value[1]))
    for end in (0, 1):
        make_delay({key: ranges[f"{name}.{key}"][end] if f"{name}.{key}" in ranges else value
                    for key, value in law.items()})  # fmt: skip
    return ranges
