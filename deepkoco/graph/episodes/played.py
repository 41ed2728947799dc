"""Nodes of an augmented replay: a recorded node that puts out what it put out, and the seat of the agent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.model.node import GraphError, Input, Node, Output, Parameters, State, Supervisor
from deepkoco.graph.model.parts import Declared, Parts


class PlayedNode(Node):
    """Puts out at its step k what was recorded at step k, whatever its inputs are.

    Args:
        name, rate, options: As for `Node`.
        recorded: (K, ...) outputs in the order of the steps.
        initial: (...) what receivers see before the first one; None: zeros.
        outputs: Shape and type of each tensor where the output has several.
    """

    finite = False  # a sensor may have said NaN

    def __init__(
        self,
        name: str,
        rate: Any,
        recorded: np.ndarray,
        *,
        initial: Tensor | None = None,
        outputs: Declared | None = None,
        **options: Any,
    ) -> None:
        super().__init__(name, rate, **options)
        if not len(recorded):
            if initial is None:
                raise GraphError(
                    f'node "{name}" has no recorded output to play; add a node of this name that runs, or give its '
                    "initial output"
                )
            recorded = initial[None].numpy()
        self.recorded = torch.from_numpy(np.array(recorded))
        self.initial = (
            torch.zeros_like(self.recorded[0]) if initial is None else initial.to(self.recorded.dtype)
        )
        if self.initial.shape != self.recorded.shape[1:]:
            raise GraphError(
                f'node "{name}": initial output {tuple(self.initial.shape)}, recorded were '
                f"{tuple(self.recorded.shape[1:])}"
            )
        self.outputs = outputs
        self._parts = None if outputs is None else Parts.of(outputs)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"step": torch.zeros(batch, dtype=torch.int64)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Output:
        return self._split(self.initial.expand(batch, *self.initial.shape))

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Output]:
        last = len(self.recorded) - 1
        output = self.recorded[state["step"].clamp(max=last)]
        return {"step": state["step"] + 1}, self._split(output)

    def _split(self, packed: Tensor) -> Output:
        return packed if self._parts is None else self._parts.split(packed)


class ReplaySupervisor(Supervisor):
    """The seat of the agent in a replay: its actions are the recorded ones, its readings what is compared.

    Args:
        name, rate, initial_action, options: As for `Supervisor`.
        compared: Input -> name of the reading (B, window, ...) of its last messages; of a node with several output
            tensors, one reading for each of them, ``NAME.TENSOR``.
    """

    def __init__(
        self, name: str, rate: Any, *, initial_action: Tensor, compared: Mapping[str, str], **options: Any
    ) -> None:
        super().__init__(name, rate, initial_action=initial_action, **options)
        self.compared = dict(compared)

    def observe(
        self, parameters: Parameters, state: State, inputs: Mapping[str, Input], action: Tensor
    ) -> tuple[State, dict[str, Tensor]]:
        readings = {}
        for name, reading in self.compared.items():
            seen = inputs[name].data
            if isinstance(seen, Mapping):
                readings |= {f"{reading}.{part}": value for part, value in seen.items()}
            else:
                readings[reading] = seen
        return state, readings
