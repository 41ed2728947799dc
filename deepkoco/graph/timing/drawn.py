"""Drawn delays in ticks, block after block, as the timing kernel reads them."""

import numpy as np

from deepkoco.graph.delay import DelayError
from deepkoco.graph.delay.source import DelaySource
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.timing.kernel import LOST
from deepkoco.graph.timing.origin import Origin
from deepkoco.graph.timing.overrides import TimingError
from deepkoco.graph.timing.plan import plan_of
from deepkoco.graph.timing.rule_tables import Draws

_BLOCK = 64  # supervisor steps in the first block; each further one doubles what there is
_STALLS = 4  # drawn at a time
_DELAYS, _STALLED, _PLAYED = 0, 1, 2  # purposes, with a generator each


class DrawnDelays:
    """Delays of one timing.

    Blocks have sizes of their own, not those asked for, and each draws all channels in one order: so the
    delays of a timing do not depend on how long it is to be.

    Attributes:
        kept: schedules for which delays are handed out.
    """

    def __init__(self, graph: Graph, origin: Origin, resolution: int) -> None:
        plan, laws, rows = plan_of(graph), origin.laws, origin.rows
        self._plan, self._laws, self._resolution = plan, laws, resolution
        self._origin = origin
        self.kept = np.arange(rows) if origin.kept is None else origin.kept
        self._whole = origin.kept is None
        self._random = {}
        for key in plan.channels:
            if key in laws.own:
                self._random[key] = laws.own[key]
            elif key in laws.same and not laws.same[key].constant:
                self._random[key] = laws.same[key]
        self._senders = np.array(
            [*range(len(graph.nodes)), *(graph.index[c.sender] for c in graph.connections)], dtype=np.int64
        )
        self._source = None
        if self._random:
            try:
                self._source = DelaySource(
                    self._random,
                    plan.periods,
                    plan.starts,
                    origin.correlations,
                    rows,
                    self._generator(_DELAYS),
                )
            except DelayError as error:
                raise TimingError(str(error)) from error
        self._player = None
        if laws.traces:
            self._player = laws.traces.player(rows, plan.rates)
            self._play = self._generator(_PLAYED)
        self._blocks = 0
        self._drawn: dict[str, list[np.ndarray]] = {key: [] for key in self._random}
        self._played: dict[str, list[np.ndarray]] = {
            k: [] for k in (laws.traces.channels if laws.traces else ())
        }
        self._begin = np.zeros((rows, len(origin.stalls), 0))
        self._end = self._begin
        self._stalled = np.ones((len(origin.stalls), len(plan.channels)), dtype=np.bool_)
        if origin.stalls:
            self._stalling = self._generator(_STALLED)
            self._stall_streams = [stalls.stream(rows) for stalls in origin.stalls]
            for g, stalls in enumerate(origin.stalls):
                if stalls.channels is not None:
                    self._stalled[g] = [key in stalls.channels for key in plan.channels]
            self.draw_stalls()

    def up_to(self, capacity: np.ndarray) -> Draws:
        """Return delays for at least capacity[n] steps of every node n, (N,)."""
        wanted = capacity[self._senders]
        while (self._widths(self._blocks) < wanted).any():
            self._draw_block()
        plan, laws = self._plan, self._laws
        channels = len(plan.channels)
        widths = np.where([k in self._drawn or k in self._played for k in plan.channels], wanted, 1)
        first = np.concatenate([[0], np.cumsum(widths)[:-1]])
        values = np.empty((len(self.kept), int(widths.sum())), dtype=np.int64)
        stride = np.zeros(channels, dtype=np.int64)
        for c, key in enumerate(plan.channels):
            start, width = int(first[c]), int(widths[c])
            if key in self._drawn or key in self._played:
                stride[c] = 1
                for block in self._drawn.get(key) or self._played[key]:
                    stop = min(start + block.shape[1], int(first[c]) + width)
                    values[:, start:stop] = (block if self._whole else block[self.kept])[:, : stop - start]
                    start = stop
            elif key in laws.constants:
                values[:, start] = np.rint(laws.constants[key][self.kept] * self._resolution)
            else:
                values[:, start] = plan.ticks_of(laws.same[key], self._resolution)
        return Draws(values, first, stride, self._ticks(self._begin), self._ticks(self._end), self._stalled)

    def draw_stalls(self) -> None:
        """Draw further stalls."""
        pieces = [stream.draw(self._stalling, _STALLS) for stream in self._stall_streams]
        begin, end = (np.stack(part, axis=1) for part in zip(*pieces, strict=True))
        self._begin = np.concatenate([self._begin, begin], axis=2)
        self._end = np.concatenate([self._end, end], axis=2)

    def _widths(self, blocks: int) -> np.ndarray:
        """Number of draws of each channel in the first `blocks` blocks, (C,)."""
        if blocks == 0:
            return np.zeros(len(self._plan.channels), dtype=np.int64)
        steps = _BLOCK * 2 ** (blocks - 1)
        return np.ceil(np.array(self._plan.ratios) * (steps * 1.02)).astype(np.int64) + self._plan.head

    def _draw_block(self) -> None:
        before, after = self._widths(self._blocks), self._widths(self._blocks + 1)
        widths = dict(zip(self._plan.channels, (after - before).tolist(), strict=True))
        if self._source is not None:
            for key, delays in self._source.block(widths).items():
                self._drawn[key].append(self._to_ticks(delays, key))
        for c, key in enumerate(self._plan.channels):
            if key in self._played and self._player is not None:
                delays = self._player.play(self._play, key, int(before[c]), widths[key])
                self._played[key].append(self._to_ticks(delays, key))
        self._blocks += 1

    def _to_ticks(self, delays: np.ndarray, key: str) -> np.ndarray:
        ticks = np.rint(delays * self._resolution)
        if key in self._laws.same and not self._laws.same[key].loses:
            return ticks.astype(np.int64)
        lost = np.isinf(ticks)
        return np.where(lost, LOST, np.where(lost, 0.0, ticks).astype(np.int64))

    def _ticks(self, seconds: np.ndarray) -> np.ndarray:
        seconds = seconds if self._whole else seconds[self.kept]
        return np.rint(np.minimum(seconds * self._resolution, float(LOST))).astype(np.int64)

    def _generator(self, purpose: int) -> np.random.Generator:
        return np.random.Generator(np.random.PCG64([self._origin.seed, purpose]))
