"""Nodes: what runs at a rate, and what it sees of the other nodes."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping
from fractions import Fraction
from numbers import Real
from typing import Any, ClassVar, NamedTuple, Self

import torch
from torch import Tensor

from deepkoco.graph.delay import Delay, DelayError, exact_fraction, make_delay
from deepkoco.graph.model.parts import Declared

State = dict[str, Tensor]
Parameters = Mapping[str, Tensor]
Output = Tensor | Mapping[str, Tensor]
SCHEDULINGS = ("frequency", "phase")


class GraphError(ValueError):
    """Nodes and connections do not make a graph; the message names the culprit."""


class Input(NamedTuple):
    """The last messages of one connection that a step sees, oldest first.

    Before `window` messages have arrived, the oldest places hold the sender's initial output, with
    seq -window..-1 and both times minus infinity (it has always been there).

    Attributes:
        data: (B, window, ...) outputs of the sender; by name where the sender declares several.
        seq: (B, window) int64 step of the sender that made each output.
        t_sent: (B, window) float64, end of that step [s].
        t_received: (B, window) float64, arrival [s].
        t_start: (B,) float64, start of the step that reads [s].
    """

    data: Any
    seq: Tensor
    t_sent: Tensor
    t_received: Tensor
    t_start: Tensor


class Node(ABC):
    """A pure function that runs at a rate; it knows its inputs and neither its neighbours nor the graph.

    Everything it remembers is in its state, and every tensor has the batch of environments first.

    Args:
        name: unique in the graph.
        rate: ticks per second [Hz].
        delay: computation delay [s], a number, a law or its description.
        scheduling: "frequency" keeps the distance between ticks after an overrun (a computation longer
            than a period shifts all later ticks), "phase" catches up with the original ticks.
        advance: with only blocking inputs, start as soon as they have arrived, before the tick.
        phase: time of the first tick [s]; None derives it from the expected delays of the inputs.
    """

    inputs: ClassVar[tuple[str, ...] | None] = None
    """Names of the inputs that `step` reads; each must be connected. None: takes whatever is connected."""

    outputs: Declared | None = None
    """Shape and type of each tensor where the output is a dict of several; None: it is one tensor."""

    pure: ClassVar[bool] = True
    """Whether `init` and `step` are functions of their arguments alone and take any batch. A node that holds
    something else (a physics engine, a connection to a robot) says False and runs in one environment."""

    finite: ClassVar[bool] = True
    """Whether outputs have neither NaN nor infinity. The runtimes of one environment (simulated, concurrent,
    wall-clock) fail on such an output and do not send it. A sensor that says "no data" with NaN says False. Of
    the supervisor it is about the actions."""

    free_rate: ClassVar[bool] = False
    """Whether nothing that the node holds was worked out from rates, its own or its senders'; only `rate` tells its
    own. A class without an `__init__` of its own need not say so, one that has one says it itself."""

    def __init__(
        self,
        name: str,
        rate: float | Fraction,
        delay: Delay | float | Mapping[str, Any] = 0.0,
        scheduling: str = "frequency",
        advance: bool = False,
        phase: float | Fraction | None = None,
    ) -> None:
        self.name = name
        self.rate = self._checked_rate(rate)
        if scheduling not in SCHEDULINGS:
            raise GraphError(f'node "{name}": scheduling "{scheduling}" is none of {", ".join(SCHEDULINGS)}')
        if phase is not None and not (isinstance(phase, Real) and 0 <= phase < float("inf")):
            raise GraphError(f'node "{name}": phase {phase} s is no number >= 0')
        try:
            self.delay = make_delay(delay)
        except DelayError as error:
            raise DelayError(f'node "{name}": {error}') from error
        if self.delay.loses:
            raise DelayError(f'node "{name}": a computation cannot get lost; only messages can')
        self.scheduling = scheduling
        self.advance = advance
        self.phase = None if phase is None else exact_fraction(phase)

    def _checked_rate(self, rate: Any) -> Fraction:
        if not isinstance(rate, Real) or not 0 < float(rate) < float("inf"):
            raise GraphError(f'node "{self.name}": rate {rate} Hz is no positive number')
        return exact_fraction(rate)  # pyright: ignore[reportArgumentType]

    def at_rate(self, rate: float | Fraction) -> Self:
        """Return a node like this one that runs at another rate [Hz].

        A class that works out something from its rate when it is made overrides this.

        Raises:
            GraphError: the rate is no positive number, or nobody says that the class can do so.
        """
        new = self._checked_rate(rate)
        if new != self.rate:
            self.check_free(f"its rate of {float(self.rate):g} Hz")
        node = copy.copy(self)
        node.rate = new
        return node

    def check_free(self, what: str) -> None:
        """Check that the node has worked out nothing from rates.

        Raises:
            GraphError: it may have, says that `what` must stay, and the way out.
        """
        if not _says_free(type(self)):
            raise GraphError(
                f'node "{self.name}": its class {type(self).__name__} may have worked out something from {what} when '
                "it was made; change the rate there, or say free_rate = True in the class if it has not"
            )

    def least_window(self, delay: Delay, sender: "Node") -> int:
        """How many of the last messages of a connection its steps must see, so that it misses none that it needs.

        Args:
            delay: of the connection.
            sender: its other end.
        """
        return 1

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        """Return the state before the first step, every tensor (B, ...); no state unless overridden."""
        return {}

    @abstractmethod
    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Output:
        """Return what receivers see before the first message has arrived, (B, ...)."""

    @abstractmethod
    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Output]:
        """Run one tick of every environment.

        A subclass may ask for its period and for noise by name, after a star:
        ``def step(self, parameters, state, inputs, *, dt, noise)``.

        Args:
            parameters: this node's parameters, each a scalar or (B, ...).
            state: what the last step returned.
            inputs: by name of the connection.

        Returns:
            The next state (same keys and shapes) and the output (B, ...), by name where there are several.
        """

    def open(self) -> None:  # noqa: B027 - most nodes have nothing to acquire
        """Acquire what `step` needs beyond its arguments, in the thread or process that will step."""

    def rest(self) -> None:  # noqa: B027
        """Leave hardware at rest after an episode, open for the next one; nothing steps until then.

        The concurrent and the wall-clock runtime call it.
        """

    def close(self) -> None:  # noqa: B027
        """Release it and leave hardware safe; called once after `open`, also when a node has failed."""


class Supervisor(Node):
    """The node whose output is the action given from outside: the seat of the agent.

    At each of its steps the action for that step comes from outside, decided on what it sees then. A subclass
    that overrides `observe` works out there what leaves the graph: observation, reward, end of the episode.

    Args:
        name: unique in the graph.
        rate: ticks per second [Hz].
        initial_action: (M,) action that its receivers see before the first one arrives.
    """

    def __init__(
        self, name: str = "agent", rate: float | Fraction = 20, *, initial_action: Tensor, **options: Any
    ) -> None:
        super().__init__(name, rate, **options)
        self.initial_action = initial_action

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return self.initial_action.expand(batch, *self.initial_action.shape)

    def observe(
        self, parameters: Parameters, state: State, inputs: Mapping[str, Input], action: Tensor
    ) -> tuple[State, dict[str, Tensor]]:
        """Work out the readings of one of its steps, before the action of that step is known.

        Pure like `step`, so that every executor can run it with the nodes.

        Args:
            parameters: this node's parameters, each a scalar or (B, ...).
            state: what the last `observe` returned; at the first step what `init` returned.
            inputs: what it sees at this step, by name of the connection.
            action: (B, M) action of the step before; at the first step the initial action.

        Returns:
            The next state and the readings (B, ...) by name; none unless overridden.
        """
        return state, {}

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        raise GraphError(f'supervisor "{self.name}" does not step: its action comes from outside')


def _says_free(kind: type[Node]) -> bool:
    """Return whether the class whose `__init__` made a node, or one below it, says that its rate is free."""
    for each in kind.__mro__:
        if each.__dict__.get("free_rate"):
            return True
        if "__init__" in each.__dict__:
            return each.__init__ in _PLAIN
    return False


_PLAIN = (Node.__init__, Supervisor.__init__)  # they keep the rate and derive nothing from it
