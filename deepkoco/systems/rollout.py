"""Interface of simulations along logs as one compiled loop: what a system offers and a simulator calls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from torch import Tensor

from deepkoco.systems.dry_friction import DryFriction


class RolledEffect(Protocol):
    """What a system reads of an effect to say whether its compiled loop has it; see `Effect`."""

    @property
    def name(self) -> str: ...

    @property
    def place(self) -> str: ...

    @property
    def steady(self) -> bool: ...


class EffectLoad(NamedTuple):
    """Load of an effect on a joint, for a compiled loop.

    Attributes:
        kind: Name of the effect, without its place.
        joint: Joint on which it acts.
        source: Joint whose actuators it follows.
        names: Of its parameters, without the effect's, in the order of their declarations.
        values: Of these parameters.
    """

    kind: str
    joint: int
    source: int
    names: tuple[str, ...]
    values: tuple[Tensor, ...]


class RolloutInput(NamedTuple):
    """Start and drive of W windows in L lanes over n steps.

    Attributes:
        step: Length of a step [s].
        start: Per state (W, L).
        time: (W, 1) log time at the start [s].
        begin: Per command (n P, W, L), effort at the start of each of the P pieces of each step.
        slope: Per command (n P, W, L), its change per second.
        loads: (J, n, W, L) outside loads [N m or N]; None for none.
        friction: Dry friction of the joints.
        length: (n P, W, L) lengths of the pieces [s], 0 for a piece that there is not; None where steps are in one.
        pieces: Number P.
    """

    step: float
    start: Sequence[Tensor]
    time: Tensor
    begin: Sequence[Tensor]
    slope: Sequence[Tensor]
    loads: Tensor | None
    friction: DryFriction
    length: Tensor | None = None
    pieces: int = 1


class RolloutResult(NamedTuple):
    """States at the n + 1 nodes of the steps, and accelerations.

    Attributes:
        value: Per state (n + 1, W, L).
        first: Per joint (n, W, L), acceleration at the start of each step.
        last: Per joint (n, W, L), acceleration at its end.
    """

    value: tuple[Tensor, ...]
    first: tuple[Tensor, ...]
    last: tuple[Tensor, ...]


class Rollout(Protocol):
    """A system under named values, ready to be simulated along logs without gradients."""

    def knows(self, kind: str) -> bool:
        """Whether it can add the loads of effects of this name."""
        ...

    def with_loads(self, loads: Sequence[EffectLoad]) -> Rollout | None:
        """The same with loads of effects; None where their values cannot be read."""
        ...

    def run(self, given: RolloutInput) -> RolloutResult | None:
        """Simulate; None where a tensor cannot be read."""
        ...
