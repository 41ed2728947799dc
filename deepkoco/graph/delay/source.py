"""Draws for all channels of a graph: the first delays are the same however many follow."""

from collections.abc import Mapping, Sequence

import numpy as np

from deepkoco.graph.delay.correlated import CopulaStream
from deepkoco.graph.delay.law import Delay, DelayError, Stream
from deepkoco.graph.delay.lossy import Lossy
from deepkoco.graph.delay.rank import RankCorrelation
from deepkoco.graph.delay.simple import Deterministic, Gamma, Gaussian, LogNormal, Uniform

_STACKABLE = (Deterministic, Uniform, Gaussian, LogNormal, Gamma)


class DelaySource:
    """Draws delays in blocks, channel by channel, all from one generator.

    Args:
        laws: by channel, a law for all rows or one for each.
        periods: by channel, time between two draws [s].
        starts: by channel, time of the first draw [s].
        correlations: between channels that draw equally often.
        rows: number of schedules.
        generator: not to be used for anything else.

    Raises:
        DelayError: laws and correlations do not go together; the message names the channels.
    """

    def __init__(
        self,
        laws: Mapping[str, Delay | Sequence[Delay]],
        periods: Mapping[str, float],
        starts: Mapping[str, float],
        correlations: Sequence[RankCorrelation],
        rows: int,
        generator: np.random.Generator,
    ) -> None:
        self._generator = generator
        self._rows = rows
        self._fresh = True
        self._groups: list[tuple[tuple[str, ...], list[CopulaStream], np.ndarray, np.ndarray]] = []
        self._losses: dict[str, float] = {}
        grouped: set[str] = set()
        for correlation in correlations:
            channels = [key for key in correlation.channels if key in laws]
            if len(channels) < len(correlation.channels):
                continue  # a channel is constant or played from a recording: nothing to correlate
            streams = [self._copula(key, laws[key], periods[key]) for key in channels]
            factors = np.array([stream.factor for stream in streams])
            self._groups.append((correlation.channels, streams, *correlation.roots(factors)))
            grouped |= set(channels)
        self._streams = {
            key: law.stream(rows, periods[key], starts[key])
            if isinstance(law, Delay)
            else rows_of(law, periods[key], starts[key])
            for key, law in laws.items()
            if key not in grouped
        }

    def block(self, widths: Mapping[str, int]) -> dict[str, np.ndarray]:
        """Return the next widths[channel] delays of every channel, (rows, width) float64 [s]."""
        drawn = {}
        for channels, streams, scores, innovations in self._groups:
            shape = len(channels), self._rows, widths[channels[0]]
            noise = self._generator.standard_normal(shape)
            mixed = np.tensordot(innovations, noise, axes=1)
            if self._fresh:
                mixed[:, :, 0] = scores @ noise[:, :, 0]
            for key, stream, own in zip(channels, streams, mixed, strict=True):
                drawn[key] = stream.from_noise(own)
                if self._losses.get(key):
                    lost = self._generator.random(own.shape) < self._losses[key]
                    drawn[key] = np.where(lost, np.inf, drawn[key])
        for key, stream in self._streams.items():
            drawn[key] = stream.draw(self._generator, widths[key])
        self._fresh = False
        return drawn

    def _copula(self, key: str, law: Delay | Sequence[Delay], period: float) -> CopulaStream:
        if isinstance(law, Lossy):
            self._losses[key] = law.probability
            law = law.delay
        one = law if isinstance(law, Delay) else stack(law)
        if one is None:
            raise DelayError(f'"{key}": laws of different kinds in one batch cannot have a rank correlation')
        try:
            one.quantile(np.full((self._rows, 1), 0.5))
        except DelayError as error:
            raise DelayError(f'"{key}": {error}') from error
        return CopulaStream(one, self._rows, period)


def stack(laws: Sequence[Delay]) -> Delay | None:
    """Return one law whose parameters are (rows, 1) arrays, or None where the laws are of different kinds."""
    kind = type(laws[0])
    if kind not in _STACKABLE or any(type(law) is not kind for law in laws):
        return None
    whole = object.__new__(kind)
    for name in kind.__dataclass_fields__:
        column = np.array([[getattr(law, name)] for law in laws])
        object.__setattr__(whole, name, column)
    return whole


class RowStream(Stream):
    """A stream for each row, where the rows have laws of different kinds."""

    def __init__(self, laws: Sequence[Delay], period: float, start: float) -> None:
        super().__init__(laws[0], len(laws))
        self._streams = [law.stream(1, period, start) for law in laws]

    def draw(self, generator: np.random.Generator, columns: int) -> np.ndarray:
        return np.concatenate([stream.draw(generator, columns) for stream in self._streams])


def rows_of(laws: Sequence[Delay], period: float, start: float) -> Stream:
    """Return a stream with a law of its own for each row."""
    whole = stack(laws)
    return Stream(whole, len(laws)) if whole is not None else RowStream(laws, period, start)
