"""A node of one environment, with its state and the messages that it holds."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.live.plan import Window
from deepkoco.graph.model.calls import call_init, call_initial_output, call_observe, call_step
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.contract import check_action, check_batch, check_finite, check_output, check_state
from deepkoco.graph.model.node import Input, Node, State, Supervisor


class InitialStateError(ValueError):
    """A state that was given for the start does not fit the node's."""


class Runner:
    """Steps one node; knows neither time nor transport.

    Args:
        node: any node, pure or not.
        inputs: its connections, in the order of the graph.
    """

    def __init__(self, node: Node, inputs: Sequence[Connection]) -> None:
        self.node, self.inputs = node, tuple(inputs)
        self.state: State = {}
        self._parameters: dict[str, Tensor] = {}
        self._messages: list[dict[int, Tensor]] = []
        self._initial: list[Tensor] = []
        self._first = torch.empty(0)

    def reset(
        self, parameters: Mapping[str, Tensor], generator: torch.Generator, initial: Mapping[str, Tensor]
    ) -> Tensor:
        """Start an episode.

        Args:
            parameters: scalars or (1, ...).
            generator: passed to the node's `init`.
            initial: (1, ...) values that replace those of `init`.

        Returns:
            The initial output (1, ...).

        Raises:
            InitialStateError: `initial` does not fit the node's state.
            GraphError: a state or the initial output has not one entry for its one environment.
            NotFiniteError: the initial output is not finite, and the node has not `finite = False`.
        """
        self._parameters = dict(parameters)
        self.state = call_init(self.node, self._parameters, generator, 1)
        for key, value in self.state.items():
            check_batch(f'initial state "{key}"', value, 1)
        for key, value in initial.items():
            if key not in self.state or value.shape != self.state[key].shape:
                there = {name: tuple(tensor.shape) for name, tensor in self.state.items()}
                raise InitialStateError(
                    f'initial "{self.node.name}.{key}" {tuple(value.shape)} does not fit {there}'
                )
            self.state[key] = value
        output = call_initial_output(self.node, self._parameters, self.state, 1)
        check_batch("initial output", output, 1)
        self.check_finite("initial output", output)
        self._first = self._own(output)
        return self._first

    def begin(self, initial_outputs: Sequence[Tensor]) -> None:
        """Take the senders' initial outputs (1, ...), one per input, and forget the last episode's messages."""
        self._initial = list(initial_outputs)
        self._messages = [{} for _ in self.inputs]

    def put(self, place: int, seq: int, data: Tensor) -> None:
        """Keep a message (1, ...) of input number `place`."""
        self._messages[place][seq] = data

    def missing(self, windows: Sequence[Window]) -> tuple[int, int] | None:
        """Return input and seq of the first message that a step needs and has not; None if there is none."""
        for place, window in enumerate(windows):
            for seq in window.seq:
                if seq >= 0 and seq not in self._messages[place]:
                    return place, seq
        return None

    def look(self, t_start: float, windows: Sequence[Window]) -> dict[str, Input]:
        """Collect what a step sees, by name of the connection."""
        start = torch.tensor([t_start], dtype=torch.float64)
        seen = {}
        for place, (connection, window) in enumerate(zip(self.inputs, windows, strict=True)):
            held = self._messages[place]
            data = [held[seq] if seq >= 0 else self._initial[place] for seq in window.seq]
            assert connection.name is not None
            seen[connection.name] = Input(
                data=connection.seen(data[0].unsqueeze(1) if len(data) == 1 else torch.stack(data, dim=1)),
                seq=torch.tensor([window.seq], dtype=torch.int64),
                t_sent=torch.tensor([window.t_sent], dtype=torch.float64),
                t_received=torch.tensor([window.t_received], dtype=torch.float64),
                t_start=start,
            )
        return seen

    def drop_before(self, oldest: Sequence[int]) -> None:
        """Forget the messages before `oldest`, one seq per input."""
        for held, first in zip(self._messages, oldest, strict=True):
            for seq in [seq for seq in held if seq < first]:
                del held[seq]

    def drop(self, place: int, seq: int) -> None:
        """Forget one message."""
        self._messages[place].pop(seq, None)

    def step(self, inputs: dict[str, Input]) -> Tensor:
        """Run one tick; return the output (1, ...).

        Raises:
            GraphError: the output or the state has another shape or type than the initial one.
            NotFiniteError: the output is not finite, and the node has not `finite = False`.
        """
        state, output = call_step(self.node, self._parameters, self.state, inputs)
        check_state(state, self.state)
        check_output(output, self._first)
        self.check_finite("output", output)
        self.state = state
        return self._own(output)

    def act(self, action: Tensor | np.ndarray, step: int) -> Tensor:
        """Return an action (1, M) of the supervisor as the receivers can keep it.

        Raises:
            ValueError: it has another shape than the initial one.
        """
        action = torch.as_tensor(action)
        check_action(self.node.name, step, action, self._first)
        return self._own(action)

    def check_finite(self, what: str, value: Tensor) -> None:
        """Refuse an output or action (1, ...) with NaN or infinity, unless the node has `finite = False`.

        Raises:
            NotFiniteError: an entry is not finite.
        """
        if self.node.finite:
            check_finite(what, value)

    def observe(self, inputs: Mapping[str, Input], action: Tensor) -> dict[str, Tensor]:
        """Let the supervisor work out its readings, with the action of the step before."""
        if not isinstance(self.node, Supervisor):
            return {}
        state, readings = call_observe(self.node, self._parameters, self.state, inputs, action)
        check_state(state, self.state)
        self.state = state
        return readings

    def _own(self, output: Tensor) -> Tensor:
        # What is not pure, or comes from outside, may be written over by what comes next.
        return output.clone() if isinstance(self.node, Supervisor) or not self.node.pure else output
