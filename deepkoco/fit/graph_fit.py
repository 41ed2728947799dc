"""Fit parameters of the nodes of a graph to an episode. A population is one batch of environments."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.identification import Convergence, Estimate, interval
from deepkoco.fit.request import FitError
from deepkoco.fit.solve.cma import Search, cma_es
from deepkoco.fit.solve.methods import Progress
from deepkoco.graph import BatchedRuntime, Graph, replay_timing
from deepkoco.graph.episodes.episode import Episode, windows_for
from deepkoco.graph.execution.state import NodeParameters
from deepkoco.graph.model.node import State

DIFFERENCE = 1e-3  # of a parameter, in the distance between its bounds, around the optimum


@dataclass(frozen=True)
class GraphFit:
    """Fitted parameters of nodes.

    Attributes:
        estimates: By ``node.parameter``. The 95 % intervals come from the curvature at the optimum; they are valid only
            where the cost is smooth.
        covariance: (p, p) in the order of ``estimates``.
        rms: Reading -> root mean square of the residuals, in the unit of the reading.
        convergence: Costs, number of simulations and reason of the end.
        search: Result of CMA-ES with all generations.
        steps_per_second: Supervisor steps simulated per second of wall-clock time.
    """

    estimates: dict[str, Estimate]
    covariance: np.ndarray
    rms: dict[str, float]
    convergence: Convergence
    search: Search
    steps_per_second: float


def seen_by_supervisor(graph: Graph, episode: Episode, connection: str) -> np.ndarray:
    """Newest message (steps, ...) of a connection that the supervisor saw at each of its steps but the first.

    A reading that returns its input shows the same messages after the steps of a replay.
    """
    sender = next(c.sender for c in graph.connections if c.key == connection)
    seqs = episode.windows[connection][1:, -1]
    output = episode.outputs[sender]
    if (seqs < 0).any():
        raise FitError(f'"{connection}": no message had arrived by step {int(np.argmax(seqs < 0)) + 1}')
    return output[seqs]


def fit_graph(
    graph: Graph,
    episode: Episode,
    parameters: NodeParameters,
    sought: Mapping[str, tuple[float, float]],
    measured: Mapping[str, np.ndarray],
    noise_sd: Mapping[str, float],
    *,
    initial: Mapping[str, State] | None = None,
    population: int = 200,
    generations: int = 100,
    seed: int = 0,
    executor: str = "fused",
    threads: int = 1,
    progress: Progress | None = None,
) -> GraphFit:
    """Fit parameters of nodes by CMA-ES: replay an episode and minimise the squared errors of the readings.

    A replay uses the recorded times instead of drawn delays, and the recorded actions instead of a policy. Each point
    of a generation is one environment of a batch. Delays inside nodes (`trainable_delay`) can be fitted too.

    Args:
        graph: The graph that was recorded.
        episode: The recording; gives timing and actions.
        parameters: Parameters of all nodes. They are the start values of those sought; else the middle of the bounds.
        sought: ``node.parameter`` -> lowest and highest value.
        measured: Reading of the supervisor -> (steps, ...) values after each action, NaN where missing.
        noise_sd: Reading -> standard deviation of its sensor.
        initial: Known states of nodes (1, ...) at the start.
        population: Points in a generation.
        generations: Largest number of generations.
        seed: Seed of all draws.
        executor, threads: As for `BatchedRuntime`.
        progress: Called with stage, generation, largest number of generations and cost.

    Raises:
        FitError: A name, shape or bound is wrong, or the replay diverges at every point.

    Source: thesis sec. 4.3 and table 4.D.
    """
    began = time.perf_counter()
    low, high = _bounds(graph, sought)
    misfit = GraphMisfit(graph, episode, parameters, sought, measured, noise_sd, initial, executor, threads)
    start = misfit.start(low, high)
    search = cma_es(
        misfit.costs,
        start,
        0.25 * (high - low),
        low,
        high,
        np.random.default_rng(seed),
        population=population,
        generations=generations,
        tolerance=1e-3,
        progress=None if progress is None else lambda k, c: progress("generations", k, generations, c),
    )
    if not np.isfinite(search.cost):
        raise FitError("the replay diverges at every point of the bounds; narrow them")
    speed = misfit.steps / (time.perf_counter() - began)
    left, covariance = _curvature(misfit.residuals, search.best, low, high)
    estimates = {}
    for i, name in enumerate(sought):
        sd, bounds = float(np.sqrt(covariance[i, i])), (float(low[i]), float(high[i]))
        value = float(search.best[i])
        estimates[name] = Estimate(name, value, *interval(value, sd, bounds), sd, "", float(start[i]), bounds)
    at, rms = 0, {}
    for name, (target, weight) in misfit.targets.items():
        own = left[at : at + target.numel()]
        rms[name] = float(np.sqrt(np.mean(own[weight.flatten().numpy() > 0] ** 2))) * noise_sd[name]
        at += target.numel()
    convergence = Convergence(
        "cma",
        search.converged,
        search.reason,
        (("generations", tuple(search.costs[:, 0].tolist())),),
        search.evaluations,
        time.perf_counter() - began,
    )
    return GraphFit(estimates, covariance, rms, convergence, search, speed)


class GraphMisfit:
    """Residuals of replays of an episode, one set of parameters per environment. Args as for `fit_graph`."""

    def __init__(
        self,
        graph: Graph,
        episode: Episode,
        parameters: NodeParameters,
        sought: Iterable[str],
        measured: Mapping[str, np.ndarray],
        noise_sd: Mapping[str, float],
        initial: Mapping[str, State] | None = None,
        executor: str = "fused",
        threads: int = 1,
    ) -> None:
        timing = replay_timing(graph, episode.measured, windows=windows_for(graph, episode))
        self.runtime = BatchedRuntime(graph, timing, executor=executor, threads=threads)
        self.actions = torch.from_numpy(np.asarray(episode.outputs[graph.supervisor]))[:, None]
        self.parameters, self.names, self.initial = parameters, tuple(sought), initial
        self.steps = 0
        for name, values in measured.items():
            if name not in noise_sd:
                raise FitError(f'noise_sd: give the standard deviation of the reading "{name}"')
            if len(values) != len(self.actions):
                raise FitError(f'measured "{name}" has {len(values)} rows for {len(self.actions)} actions')
        self.targets: dict[str, tuple[Tensor, Tensor]] = {}  # values and weights (steps, n), 0 where missing
        for name, values in measured.items():
            target = torch.from_numpy(np.array(values, dtype=np.float64)).flatten(1)
            there = ~torch.isnan(target)
            self.targets[name] = target.nan_to_num(), there / noise_sd[name]

    def start(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Start values (p,): the given ones, cut at the bounds, else the middle of the bounds."""
        values = []
        for name, a, b in zip(self.names, low, high, strict=True):
            node, parameter = name.split(".", 1)
            present = self.parameters.get(node, {}).get(parameter)
            values.append(0.5 * (a + b) if present is None else float(np.clip(float(present), a, b)))
        return np.array(values)

    def residuals(self, points: np.ndarray) -> Tensor:
        """Residuals (B, samples) of points (B, p), in noise standard deviations."""
        return torch.cat([part.movedim(1, 0).flatten(1) for part in self._parts(points)], 1)

    def costs(self, points: np.ndarray) -> np.ndarray:
        """Sums of squared residuals (B,) of points (B, p)."""
        return torch.stack([part.square_().sum((0, 2)) for part in self._parts(points)]).sum(0).numpy()

    def _parts(self, points: np.ndarray) -> list[Tensor]:
        """Residuals (steps, B, n) of each reading, in noise standard deviations."""
        taken = self._replayed(points)
        parts = []
        for name, (target, weight) in self.targets.items():
            miss = taken[name].flatten(2).to(torch.float64)
            parts.append(miss.sub_(target[:, None]).mul_(weight[:, None]))
        return parts

    def _replayed(self, points: np.ndarray) -> dict[str, Tensor]:
        """Readings (steps, B, ...) of points (B, p)."""
        batch = len(points)
        own = {node: dict(values) for node, values in self.parameters.items()}
        for i, name in enumerate(self.names):
            node, parameter = name.split(".", 1)
            values = own.setdefault(node, {})
            column = torch.from_numpy(np.ascontiguousarray(points[:, i]))
            # A graph in single precision needs parameters in single precision.
            values[parameter] = column.to(values[parameter].dtype) if parameter in values else column
        initial = self.initial
        if initial is not None:
            initial = {
                node: {k: v.expand(batch, *v.shape[1:]).contiguous() for k, v in state.items()}
                for node, state in initial.items()
            }
        rows = np.zeros(batch, dtype=np.int64)
        state, _ = self.runtime.reset(own, torch.Generator().manual_seed(0), initial, rows=rows)
        _, taken = self.runtime.rollout(state, self.actions, len(self.actions), record=list(self.targets))
        self.steps += batch * len(self.actions)
        return taken


def _bounds(graph: Graph, sought: Mapping[str, tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    if not sought:
        raise FitError("no parameter to fit: give node.parameter with its bounds")
    known = {node.name for node in graph.nodes}
    for name, (low, high) in sought.items():
        node, _, parameter = name.partition(".")
        if node not in known or not parameter:
            raise FitError(
                f'"{name}" is not of the form node.parameter; the nodes are {", ".join(sorted(known))}'
            )
        if not (np.isfinite([low, high]).all() and low < high):
            raise FitError(
                f"{name}: bounds {low:g} to {high:g}: give two finite numbers, the lower one first"
            )
    values = np.array(list(sought.values()), dtype=np.float64)
    return values[:, 0], values[:, 1]


def _curvature(
    residuals: Callable[[np.ndarray], Tensor], best: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals at the optimum, and covariance by central differences, times chi2 per sample where above 1."""
    step = DIFFERENCE * (high - low)
    up, down = np.minimum(best + step, high), np.maximum(best - step, low)
    points = np.concatenate([best[None], best + np.diag(up - best), best + np.diag(down - best)])
    left = residuals(points).numpy()
    count = len(best)
    slope = (left[1 : 1 + count] - left[1 + count :]) / (up - down)[:, None] * (high - low)[:, None]
    information = slope @ slope.T
    # Prior: a uniform law between the bounds has the variance (high - low)^2 / 12.
    covariance = np.linalg.inv(information + 12.0 * np.eye(count))
    return left[0], covariance * np.outer(high - low, high - low) * max(1.0, float(np.mean(left[0] ** 2)))
