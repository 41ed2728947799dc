"""Residuals of replays of a graph, one set of parameters per environment of a batch."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.request import FitError
from deepkoco.graph import BatchedRuntime, ComputationGraph, Graph, replay_timing
from deepkoco.graph.episodes.episode import Episode, windows_for
from deepkoco.graph.execution.state import NodeParameters
from deepkoco.graph.model.node import State

NoiseSd = float | np.ndarray
"""Standard deviation of the noise of a reading, of all its channels or (N,) of each."""
Retime = Callable[[dict[str, np.ndarray]], ComputationGraph]
"""From delays (B,) [s] by connection or node, the timing in which schedule b has the delays b."""
_ENTRY = re.compile(r"(?P<parameter>.+)\[(?P<place>\d+)\]")


class Misfit:
    """Residuals of a graph that runs recorded actions.

    Args:
        graph: What runs.
        timing: When it runs.
        actions: (steps, 1, M) of the supervisor.
        parameters: Parameters of all nodes.
        sought: What is fitted: ``node.parameter``, ``node.parameter[i]`` for entry i of a vector, or, where there is
            ``retime``, a node or connection for its delay.
        measured: Reading of the supervisor -> (steps, ...) values after each action, NaN where missing.
        noise_sd: Reading -> standard deviation of its sensor.
        initial: Known states of nodes (1, ...) at the start.
        executor, threads: As for `BatchedRuntime`.
        retime: Makes the timing for fitted delays.
    """

    def __init__(
        self,
        graph: Graph,
        timing: ComputationGraph,
        actions: Tensor,
        parameters: NodeParameters,
        sought: Iterable[str],
        measured: Mapping[str, np.ndarray],
        noise_sd: Mapping[str, NoiseSd],
        initial: Mapping[str, State] | None = None,
        executor: str = "fused",
        threads: int = 1,
        retime: Retime | None = None,
    ) -> None:
        self.runtime = BatchedRuntime(graph, timing, executor=executor, threads=threads)
        self.actions, self.retime = actions, retime
        self.parameters, self.names, self.initial = parameters, tuple(sought), initial
        self.delays = delay_names(graph, self.names)
        self.steps = 0
        for name, values in measured.items():
            if name not in noise_sd:
                raise FitError(f'noise_sd: give the standard deviation of the reading "{name}"')
            if len(values) != len(self.actions):
                raise FitError(f'measured "{name}" has {len(values)} rows for {len(self.actions)} actions')
        # Values, weights (steps, n), 0 where missing, and standard deviations (n,).
        self.targets: dict[str, tuple[Tensor, Tensor]] = {}
        self.noise_sd: dict[str, np.ndarray] = {}
        for name, values in measured.items():
            target = torch.from_numpy(np.array(values, dtype=np.float64))
            try:
                spread = np.broadcast_to(np.asarray(noise_sd[name], dtype=np.float64), target.shape[1:])
            except ValueError as error:
                raise FitError(
                    f'noise_sd "{name}": {np.shape(noise_sd[name])} does not fit values of {tuple(target.shape[1:])}'
                ) from error
            self.noise_sd[name] = spread.ravel()
            target = target.reshape(len(target), -1)  # a reading may be one number, (steps,)
            there = ~torch.isnan(target)
            self.targets[name] = target.nan_to_num(), there / torch.from_numpy(self.noise_sd[name].copy())

    @property
    def samples(self) -> int:
        """Number of measured values."""
        return sum(int((weight > 0).sum()) for _, weight in self.targets.values())

    def start(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Start values (p,): the given ones, cut at the bounds, else the middle of the bounds."""
        values = []
        for name, a, b in zip(self.names, low, high, strict=True):
            present = None if name in self.delays else self._given(name)
            values.append(0.5 * (a + b) if present is None else float(np.clip(present, a, b)))
        return np.array(values)

    def residuals(self, points: np.ndarray) -> Tensor:
        """Residuals (B, samples) of points (B, p), in noise standard deviations."""
        return torch.cat([part.movedim(1, 0).flatten(1) for part in self._parts(points)], 1)

    def costs(self, points: np.ndarray) -> np.ndarray:
        """Sums of squared residuals (B,) of points (B, p)."""
        return torch.stack([part.square_().sum((0, 2)) for part in self._parts(points)]).sum(0).numpy()

    def rms(self, residuals: np.ndarray) -> dict[str, float]:
        """Root mean square (samples,) of each reading, in its unit; of channels with different noise, the mean."""
        at, found = 0, {}
        for name, (target, weight) in self.targets.items():
            own = residuals[at : at + target.numel()].reshape(tuple(target.shape)) * self.noise_sd[name]
            found[name] = float(np.sqrt(np.mean(own[weight.numpy() > 0] ** 2)))
            at += target.numel()
        return found

    def _parts(self, points: np.ndarray) -> list[Tensor]:
        """Residuals (steps, B, n) of each reading, in noise standard deviations."""
        taken = self._replayed(points)
        parts = []
        for name, (target, weight) in self.targets.items():
            shown = taken[name]
            miss = shown.reshape(*shown.shape[:2], -1).to(torch.float64, copy=True)
            parts.append(miss.sub_(target[:, None]).mul_(weight[:, None]))
        return parts

    def _replayed(self, points: np.ndarray) -> dict[str, Tensor]:
        """Readings (steps, B, ...) of points (B, p)."""
        batch = len(points)
        own = {node: dict(values) for node, values in self.parameters.items()}
        delays: dict[str, np.ndarray] = {}
        for i, name in enumerate(self.names):
            column = np.ascontiguousarray(points[:, i])
            if name in self.delays:
                delays[name] = column
            else:
                _put(own, name, torch.from_numpy(column))
        initial = self.initial
        if initial is not None:
            initial = {
                node: {k: v.expand(batch, *v.shape[1:]).contiguous() for k, v in state.items()}
                for node, state in initial.items()
            }
        generator = torch.Generator().manual_seed(0)
        if delays and self.retime is not None:
            state, _ = self.runtime.reset(own, generator, initial, timing=self.retime(delays))
        else:
            rows = np.zeros(batch, dtype=np.int64)
            state, _ = self.runtime.reset(own, generator, initial, rows=rows)
        _, taken = self.runtime.rollout(state, self.actions, len(self.actions), record=list(self.targets))
        self.steps += batch * len(self.actions)
        return taken

    def _given(self, name: str) -> float | None:
        node, parameter = name.split(".", 1)
        values = self.parameters.get(node, {})
        if parameter in values:
            return float(values[parameter])
        entry = _entry_of(values, name)
        return None if entry is None else float(values[entry[0]].flatten()[entry[1]])


class GraphMisfit(Misfit):
    """Residuals of replays of an episode in the graph that was recorded. Args as for `fit_graph`."""

    def __init__(
        self,
        graph: Graph,
        episode: Episode,
        parameters: NodeParameters,
        sought: Iterable[str],
        measured: Mapping[str, np.ndarray],
        noise_sd: Mapping[str, NoiseSd],
        initial: Mapping[str, State] | None = None,
        executor: str = "fused",
        threads: int = 1,
    ) -> None:
        timing = replay_timing(graph, episode.measured, windows=windows_for(graph, episode))
        actions = torch.from_numpy(np.asarray(episode.outputs[graph.supervisor]))[:, None]
        super().__init__(
            graph, timing, actions, parameters, sought, measured, noise_sd, initial, executor, threads
        )


def delay_names(graph: Graph, names: Iterable[str]) -> frozenset[str]:
    """Those names that are connections or nodes: their delays."""
    channels = {*graph.index, *(connection.key for connection in graph.connections)}
    return frozenset(name for name in names if name in channels)


def _put(parameters: dict[str, dict[str, Tensor]], name: str, column: Tensor) -> None:
    """Put a parameter's values (B,) in its place."""
    node, parameter = name.split(".", 1)
    values = parameters.setdefault(node, {})
    entry = None if parameter in values else _entry_of(values, name)
    if entry is None:
        # A graph in single precision needs parameters in single precision.
        values[parameter] = column.to(values[parameter].dtype) if parameter in values else column
        return
    whole, place = entry
    vector = values[whole]
    spread = vector.reshape(-1, vector.shape[-1]).expand(len(column), vector.shape[-1]).clone()
    spread[:, place] = column.to(vector.dtype)
    values[whole] = spread


def _entry_of(values: Mapping[str, Tensor], name: str) -> tuple[str, int] | None:
    """The vector and the place in it that a name ``node.parameter[i]`` means; None: it has another form.

    Raises:
        FitError: There is no such vector, or it is shorter.
    """
    node, parameter = name.split(".", 1)
    entry = _ENTRY.fullmatch(parameter)
    if entry is None:
        return None
    whole, place = entry["parameter"], int(entry["place"])
    if whole not in values:
        raise FitError(f'"{name}": give a start value of the vector "{node}.{whole}"')
    width = values[whole].shape[-1] if values[whole].ndim else 0
    if place >= width:
        raise FitError(f'"{name}": "{node}.{whole}" has {width} entries')
    return whole, place
