"""What sequences of actions cost on a graph: a model for planners that roll it out with its delays, or without."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from deepkoco.graph import BatchedRuntime, Graph, draw_timing
from deepkoco.graph.execution.runtime import NodeParameters
from deepkoco.graph.model.node import State


class GraphRollouts:
    """Rolls a graph out from given states, for E problems with S sequences of actions each, all in one batch.

    All delays are constant: their means, or none. The cost of a sequence is the sum of minus the graph's reward after
    each of its actions.

    Args:
        graph: Its supervisor reads ``reward``.
        longest: Most actions of a rollout, those of the past included.
        parameters: Of the nodes; None: their own.
        delays: False: every message arrives at once and no computation takes time.
        executor: As for `BatchedRuntime`.
    """

    def __init__(
        self,
        graph: Graph,
        longest: int,
        parameters: NodeParameters | None = None,
        delays: bool = True,
        executor: str = "eager",
    ) -> None:
        self.graph, self.longest = graph, longest
        laws = {c.key: c.law for c in graph.connections} | {node.name: node.delay for node in graph.nodes}
        means = {name: law.mean if delays else 0.0 for name, law in laws.items()}
        timing = draw_timing(graph, torch.Generator().manual_seed(0), longest, 1, delays=means, rows=1)
        self._runtime = BatchedRuntime(graph, timing, executor=executor)
        self._parameters = parameters or {}

    @torch.inference_mode()
    def costs(self, start: Mapping[str, State], past: np.ndarray, plans: np.ndarray) -> np.ndarray:
        """Costs (E, S).

        Args:
            start: States (E, ...) by node at the first action of the past, where they are not those of `Node.init`.
            past: (E, P, M) actions that were taken since then, at steps that are not paid for.
            plans: (E, S, H, M) actions to come.

        Raises:
            ValueError: Past and plans are longer than `longest`.
        """
        loops, samples, horizon, width = plans.shape
        steps = past.shape[1] + horizon
        if steps > self.longest:
            raise ValueError(f"{steps} actions: these rollouts were made for {self.longest}")
        before = np.broadcast_to(past[:, None], (loops, samples, *past.shape[1:]))
        actions = np.concatenate([before, plans], 2).reshape(loops * samples, steps, width)
        initial = {
            node: {name: value.repeat_interleave(samples, 0) for name, value in state.items()}
            for node, state in start.items()
        }
        rows = np.zeros(loops * samples, np.int64)
        state, _ = self._runtime.reset(self._parameters, torch.Generator().manual_seed(0), initial, rows=rows)
        taken = torch.from_numpy(np.ascontiguousarray(actions.swapaxes(0, 1)))
        _, found = self._runtime.rollout(state, taken, record=["reward"])
        cost = -found["reward"][past.shape[1] :].sum(0)
        return cost.reshape(loops, samples).cpu().numpy()
