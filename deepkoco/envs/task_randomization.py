"""Randomization of a task: delays by name, and parameters of its system."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from deepkoco.envs.delay_traces import Delays
from deepkoco.envs.randomization import read_ranges
from deepkoco.envs.settings import DELAYS, EnvironmentSettings
from deepkoco.graph import Graph
from deepkoco.graph.delay import make_delay
from deepkoco.systems.system import System

ESTIMATOR = "estimator"


class TaskRandomization:
    """What the environments of one task draw: delays, and parameters that all nodes share.

    Args:
        system: The system with its parameters.
        settings: The settings, with the ranges.
        graph: Nodes and connections.

    Raises:
        ValueError: A range is none.
    """

    def __init__(self, system: System, settings: EnvironmentSettings, graph: Graph) -> None:
        self._system, self._settings, self._graph = system, settings, graph
        names = {*DELAYS, *(f"{name}.delay" for name in DELAYS)}
        receiver = ESTIMATOR if ESTIMATOR in graph.index else "agent"
        self._edges = {"actuation_delay": "agent->world", "sensing_delay": f"sensor->{receiver}"}
        self.ranges, self.timed = read_ranges(settings.randomize, names, self._bounds)

    def delays(self, draws: Mapping[str, Tensor]) -> Delays:
        timing = self._system.timing(self._system.default_parameters() | dict(draws))
        delays = {}
        for name, own in zip(DELAYS, (timing.actuation_delay, timing.sensing_delay), strict=True):
            if name in draws or own.ndim > 0:
                law = make_delay(getattr(self._settings, name))
                base = draws[name] if name in draws else torch.tensor(float(law.mean), dtype=torch.float64)
                delays[self._edges[name]] = (base + own).numpy()
        return delays

    def parameters(self, drawn: Mapping[str, Tensor]) -> Mapping[str, Mapping[str, Tensor]]:
        nominal = self._system.default_parameters()
        parameters = nominal | {name: value for name, value in drawn.items() if name not in DELAYS}
        # An estimator cannot know what an environment has drawn.
        return {node.name: nominal if node.name == ESTIMATOR else parameters for node in self._graph.nodes}

    def _bounds(self, name: str) -> tuple[float, float, str]:
        if name in DELAYS:
            return 0.0, math.inf, "s"
        declared = self._system.parameter(name)
        return declared.low, declared.high, declared.unit
