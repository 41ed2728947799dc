"""The origin of a drawn timing: all that determines its delays."""

from dataclasses import dataclass, replace

import numpy as np

from deepkoco.graph.delay import RankCorrelation, Stalls
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.timing.overrides import ChannelLaws


@dataclass(frozen=True)
class Origin:
    """All that determines the delays of a timing; `kept` are the schedules left of `rows`, None: all."""

    graph: Graph
    seed: int
    laws: ChannelLaws
    correlations: tuple[RankCorrelation, ...]
    stalls: tuple[Stalls, ...]
    rows: int
    kept: np.ndarray | None

    def take(self, rows: np.ndarray) -> "Origin":
        """Keep some of the schedules."""
        return replace(self, kept=rows if self.kept is None else self.kept[rows])
