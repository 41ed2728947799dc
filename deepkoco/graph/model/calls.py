"""Calls of a node's functions, with what they ask for beyond their arguments: `dt` and `noise`.

A node asks by name, after a star: ``def step(self, parameters, state, inputs, *, dt, noise)``. Every executor and
runtime calls nodes by the functions below, so that what they are given is the same everywhere.

The noise of an environment follows from a key that it draws after the node's `init`, and from the number of the
step. Both are kept in the state of the node, beside what `init` returns; the node itself does not see them there.
"""

import inspect
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from deepkoco.graph.model.node import GraphError, Input, Node, Parameters, State, Supervisor
from deepkoco.graph.model.noise import Noise, draw_keys
from deepkoco.graph.model.parts import Parts, PartsError

OFFERED = ("dt", "noise")
KEY, STEP = "noise.key", "noise.step"
"""Entries of the state of a node that asks for noise."""
EXTRA_DELAY = ".extra_delay"
"""End of the name of a parameter that every node has for each of its inputs: see `later`."""


@lru_cache(maxsize=1024)
def asked_by(function: Callable[..., Any]) -> frozenset[str]:
    """Names of what a node's function asks for: those of its parameters after a star that are offered."""
    parameters = inspect.signature(function).parameters.values()
    return frozenset(p.name for p in parameters if p.kind is p.KEYWORD_ONLY and p.name in OFFERED)


def check_asked(node: Node) -> None:
    """Check what a node's functions ask for.

    Raises:
        GraphError: something else than `dt` and `noise`, or without the star.
    """
    for name in ("step", "observe") if isinstance(node, Supervisor) else ("step",):
        given = len(inspect.signature(getattr(Supervisor, name)).parameters)
        parameters = list(inspect.signature(getattr(type(node), name)).parameters.values())
        for place, p in enumerate(parameters):
            wanted = p.default is p.empty and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
            after_star = p.kind is p.KEYWORD_ONLY
            if wanted and (p.name not in OFFERED if after_star else place >= given):
                names = ", ".join(q.name for q in parameters[:given])
                raise GraphError(
                    f'node "{node.name}": {name} asks for "{p.name}"; beyond its arguments it can ask for dt and '
                    f"noise, after a star: def {name}({names}, *, dt, noise)"
                )


def call_init(node: Node, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
    """The state (B, ...) that a node starts with, and the key of its noise if it asks for noise."""
    state = dict(node.init(parameters, generator, batch))
    if "noise" in asked_by(_function(node)):
        for key in (KEY, STEP):
            if key in state:
                raise GraphError(
                    f'node "{node.name}": its noise is kept in the state "{key}"; rename this state'
                )
        begun = torch.zeros(batch, dtype=torch.int64, device=generator.device)
        state |= {KEY: draw_keys(batch, generator), STEP: begun}
    return state


def call_initial_output(node: Node, parameters: Parameters, state: State, batch: int) -> Tensor:
    """What receivers see before the first message has arrived, (B, ...)."""
    return _packed(node, node.initial_output(parameters, _own(state), batch))


def call_step(
    node: Node, parameters: Parameters, state: State, inputs: dict[str, Input]
) -> tuple[State, Tensor]:
    """Run one tick; see `Node.step`."""
    asked, inputs = asked_by(type(node).step), later(parameters, inputs)
    if not asked:
        after, output = node.step(parameters, state, inputs)
        return after, _packed(node, output)
    after, output = node.step(parameters, _own(state), inputs, **_given(node, asked, state))
    return _next(state, after), _packed(node, output)


def call_observe(
    node: Supervisor, parameters: Parameters, state: State, inputs: Mapping[str, Input], action: Tensor
) -> tuple[State, dict[str, Tensor]]:
    """Work out the readings of a step; see `Supervisor.observe`."""
    asked, inputs = asked_by(type(node).observe), later(parameters, inputs)
    if not asked:
        return node.observe(parameters, state, inputs, action)
    after, readings = node.observe(parameters, _own(state), inputs, action, **_given(node, asked, state))
    return _next(state, after), readings


def later(parameters: Parameters, inputs: Mapping[str, Input]) -> dict[str, Input]:
    """The inputs with arrivals that are later by the parameters ``INPUT.extra_delay`` [s], scalars or (B,).

    Which messages a step sees stays as the timing says. Where a node reads when they arrived, a loss can be
    differentiated with respect to the delay: the hold integral of a world gives an older command a larger part of
    the tick.

    Raises:
        GraphError: there is no such input.
    """
    found = dict(inputs)
    for name, delay in parameters.items():
        own = name.removesuffix(EXTRA_DELAY)
        if own != name:
            if own not in found:
                raise GraphError(
                    f'parameter "{name}": no input "{own}"; there are {", ".join(found) or "none"}'
                )
            shift = delay.to(torch.float64)
            arrival = found[own].t_received + (shift.unsqueeze(-1) if shift.ndim else shift)
            found[own] = found[own]._replace(t_received=arrival)
    return found


def _packed(node: Node, output: Any) -> Any:
    """An output as it travels, (B, ...).

    Raises:
        GraphError: a dict is not what the node declares.
    """
    if node.outputs is None:
        if isinstance(output, Mapping):
            raise GraphError(
                f'node "{node.name}": the output is a dict; declare shape and type of each part: '
                f"outputs = {{{', '.join(map(_declaration, output.items()))}}}"
            )
        return output
    try:
        return _parts(
            tuple((name, tuple(shape), dtype) for name, (shape, dtype) in node.outputs.items())
        ).pack(output)
    except PartsError as error:
        raise GraphError(f'node "{node.name}": {error}') from error


@lru_cache(maxsize=1024)
def _parts(declared: tuple[tuple[str, tuple[int, ...], torch.dtype], ...]) -> Parts:
    return Parts.of({name: (shape, dtype) for name, shape, dtype in declared})


def _declaration(entry: tuple[str, Any]) -> str:
    name, value = entry
    return (
        f'"{name}": ({tuple(value.shape[1:])}, {value.dtype})'
        if isinstance(value, Tensor)
        else f'"{name}": ...'
    )


def _function(node: Node) -> Callable[..., Any]:
    """What runs at the node's ticks."""
    return type(node).observe if isinstance(node, Supervisor) else type(node).step


def _given(node: Node, asked: frozenset[str], state: State) -> dict[str, Any]:
    offered = {"dt": lambda: float(1 / node.rate), "noise": lambda: Noise(state[KEY], state[STEP])}
    return {name: offered[name]() for name in asked}


def _own(state: State) -> State:
    """The state as the node knows it."""
    if KEY not in state:
        return state
    return {key: value for key, value in state.items() if key not in (KEY, STEP)}


def _next(state: State, after: Any) -> Any:
    """What the node returned, with the noise of its next step."""
    if KEY not in state or not isinstance(after, Mapping):
        return after
    return {**after, KEY: state[KEY], STEP: state[STEP] + 1}
