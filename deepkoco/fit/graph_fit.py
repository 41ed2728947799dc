"""Fit parameters of the nodes of a graph to a recording. A population is one batch of environments."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from deepkoco.fit.graph_misfit import GraphMisfit, Misfit, NoiseSd, delay_names
from deepkoco.fit.identification import Convergence, Estimate, interval
from deepkoco.fit.request import FitError
from deepkoco.fit.solve.cma import Search, cma_es
from deepkoco.fit.solve.methods import Progress
from deepkoco.graph import Graph
from deepkoco.graph.episodes.augmented import AugmentedReplay
from deepkoco.graph.episodes.episode import Episode
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
    low, high = _bounds(graph, sought)
    misfit = GraphMisfit(graph, episode, parameters, sought, measured, noise_sd, initial, executor, threads)
    if misfit.delays:
        name = min(misfit.delays)
        raise FitError(
            f'"{name}" was measured: its delay is not fitted; replay_record adds nodes with delays of their own'
        )
    return _search(misfit, sought, low, high, population, generations, seed, progress)


def fit_replay(
    replay: AugmentedReplay,
    parameters: NodeParameters,
    sought: Mapping[str, tuple[float, float]],
    noise_sd: Mapping[str, NoiseSd],
    *,
    initial: Mapping[str, State] | None = None,
    population: int = 200,
    generations: int = 100,
    seed: int = 0,
    executor: str = "fused",
    threads: int = 1,
    progress: Progress | None = None,
) -> GraphFit:
    """Fit parameters of added nodes, and hidden delays, to a recording of real nodes.

    Every message of a compared sensor is one sample: what was recorded, and what the simulated sensor puts out at the
    measured time. The delay of an added node or connection is fitted like a parameter, under its name; each point of a
    generation then has a timing of its own. A delay inside a node (`trainable_delay`) is a parameter of this node.

    Args:
        replay: From `deepkoco.graph.episodes.augmented.replay_record`.
        parameters: Parameters of the nodes. They are the start values of those sought; else the middle of the bounds.
        sought: ``node.parameter``, ``node.parameter[i]`` or an added node or connection (its delay [s]) -> lowest and
            highest value.
        noise_sd: Compared sensor -> standard deviation of its noise, of all channels or of each.
        initial, population, generations, seed, executor, threads, progress: As for `fit_graph`.

    Raises:
        FitError: A name, shape or bound is wrong, nothing is compared, or the replay diverges at every point.
    """
    low, high = _bounds(replay.graph, sought)
    if not replay.compared:
        raise FitError("the replay compares nothing: add a node that runs in the place of a recorded sensor")
    if unknown := [name for name in noise_sd if name not in replay.compared]:
        raise FitError(f'noise_sd "{unknown[0]}": compared are {", ".join(replay.compared)}')
    for name in delay_names(replay.graph, sought):
        if name not in replay.added:
            raise FitError(f'"{name}" was measured: only delays of what was added can be fitted')
        if sought[name][0] < 0.0:
            raise FitError(f"{name}: a delay is not below 0; raise the lower bound {sought[name][0]:g}")
    misfit = Misfit(
        replay.graph,
        replay.timing,
        replay.actions,
        parameters,
        sought,
        {name: values for name, values in replay.compared.items() if name in noise_sd},
        noise_sd,
        initial,
        executor,
        threads,
        replay.timing_of_each,
    )
    return _search(misfit, sought, low, high, population, generations, seed, progress)


def _search(
    misfit: Misfit,
    sought: Mapping[str, tuple[float, float]],
    low: np.ndarray,
    high: np.ndarray,
    population: int,
    generations: int,
    seed: int,
    progress: Progress | None,
) -> GraphFit:
    """Minimise a misfit by CMA-ES, and work out intervals from the curvature at the optimum."""
    began = time.perf_counter()
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
    left, covariance = _curvature(misfit, search.best, low, high)
    estimates = {}
    for i, name in enumerate(sought):
        sd, bounds = float(np.sqrt(covariance[i, i])), (float(low[i]), float(high[i]))
        unit = "s" if name in misfit.delays else ""
        value = float(search.best[i])
        estimates[name] = Estimate(
            name, value, *interval(value, sd, bounds), sd, unit, float(start[i]), bounds
        )
    convergence = Convergence(
        "cma",
        search.converged,
        search.reason,
        (("generations", tuple(search.costs[:, 0].tolist())),),
        search.evaluations,
        time.perf_counter() - began,
    )
    return GraphFit(estimates, covariance, misfit.rms(left), convergence, search, speed)


def _bounds(graph: Graph, sought: Mapping[str, tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    if not sought:
        raise FitError("no parameter to fit: give node.parameter with its bounds")
    known = {node.name for node in graph.nodes}
    delays = delay_names(graph, sought)
    for name, (low, high) in sought.items():
        node, _, parameter = name.partition(".")
        if name not in delays and (node not in known or not parameter):
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
    misfit: Misfit, best: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals at the optimum, and covariance by central differences, times chi2 per sample where above 1."""
    step = DIFFERENCE * (high - low)
    up, down = np.minimum(best + step, high), np.maximum(best - step, low)
    points = np.concatenate([best[None], best + np.diag(up - best), best + np.diag(down - best)])
    left = misfit.residuals(points).numpy()
    count = len(best)
    slope = (left[1 : 1 + count] - left[1 + count :]) / (up - down)[:, None] * (high - low)[:, None]
    information = slope @ slope.T
    # Prior: a uniform law between the bounds has the variance (high - low)^2 / 12.
    covariance = np.linalg.inv(information + 12.0 * np.eye(count))
    return left[0], covariance * np.outer(high - low, high - low) * max(
        1.0, float(np.sum(left[0] ** 2)) / misfit.samples
    )
