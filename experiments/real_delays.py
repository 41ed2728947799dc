"""Study: model measured delays, test the model on held-out halves, reproduce stalls and rank correlations.

python -m experiments.real_delays DATA_FOLDER --out results/graph/real_delays
"""

from __future__ import annotations

import argparse
import csv
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.stats import anderson_ksamp, kstwobign, spearmanr

from deepkoco.graph import Connection, Delay, Graph, Node, Supervisor, draw_timing
from deepkoco.graph.episodes.fitting import DelayModel, find_stalls, fit_delays
from deepkoco.graph.episodes.fitting.mixture_fit import fit_mixture
from deepkoco.graph.episodes.fitting.model import normal_scores
from deepkoco.output.new_folder import new_folder
from experiments.real_delays_report import draw_distances, draw_distributions, draw_stalls, report

WARM_UP = 1.0  # [s]; the first samples of most channels are several times as long
TOLERANCE = 1.0  # [s]; the clocks of channels are known from their sample numbers alone
STRETCH = 2.5  # [s]
SIMULATED = 20  # recordings simulated for each measured one


class Setup(NamedTuple):
    """A measured graph: supervisor, nominal duration [s], and where each channel of the file belongs."""

    supervisor: str
    duration: float
    publishers: Mapping[str, str]  # name of an output -> node
    skipped: frozenset[str]  # connections that close a cycle


PENDULUM = {"action": "agent", "last_action": "actuator", "state": "sensor"}
LOOP = frozenset({"actuator->world", "actuator->agent"})
ARM = frozenset({"armactuator->world"})
SETUPS = {
    "pendulum_real_20hz": Setup("agent", 100.0, PENDULUM, LOOP),
    "pendulum_real_30hz": Setup("agent", 50.0, PENDULUM, LOOP),
    "double_pendulum_real_80hz": Setup("agent", 45.0, PENDULUM, LOOP),
    "vx300s_real_3hz": Setup("supervisor", 250.0, {}, ARM),
    "vx300s_real_3p5hz": Setup("supervisor", 250.0, {}, ARM),
    "vx300s_real_smallS_3hz": Setup("supervisor", 250.0, {}, ARM),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study; return the exit status."""
    parser = argparse.ArgumentParser(description="Model measured delays and test the model.")
    parser.add_argument("data", type=Path, help="folder with *_hz.npz files of measured delays")
    parser.add_argument("--out", type=Path, default=Path("results/graph/real_delays"))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    missing = [name for name in SETUPS if not (options.data / f"{name}.npz").is_file()]
    if missing:
        print(f"error: {options.data}: there is no {missing[0]}.npz", file=sys.stderr)
        return 2
    if options.out.exists():
        print(f"error: {options.out}: exists; move it away or pass --out", file=sys.stderr)
        return 2
    channels, stalls, ranks = [], [], []
    figures: dict[str, Any] = {}
    for name, setup in SETUPS.items():
        delays = load(options.data / f"{name}.npz", setup)
        rates = {key: len(delay) / setup.duration for key, delay in delays.items()}
        first = {key: delay[: len(delay) // 2] for key, delay in delays.items()}
        second = {key: delay[len(delay) // 2 :] for key, delay in delays.items()}
        half = fit_delays(first, rates, warm_up=WARM_UP, tolerance=TOLERANCE)
        whole = fit_delays(delays, rates, warm_up=WARM_UP, tolerance=TOLERANCE)
        for key, law in half.laws.items():
            begin = int(np.ceil(WARM_UP * rates[key]))
            halves = compare(key, first[key][begin:], second[key], law)
            channels.append({"dataset": name, **halves, **interleaved(delays[key][begin:], rates[key])})
        simulated = simulate(name, setup, rates, whole, options.seed)
        stalls.append({"dataset": name, **compare_stalls(delays, rates, simulated, half, setup.duration)})
        ranks += [
            {"dataset": name, **row} for row in compare_ranks(delays, (first, second), simulated, whole)
        ]
        figures[name] = first, second, half, delays, simulated, rates
        print(f"{name}: {len(delays)} channels", file=sys.stderr)
    with new_folder(options.out) as partial:
        for file, rows in (
            ("channels.csv", channels),
            ("stalls.csv", stalls),
            ("rank_correlations.csv", ranks),
        ):
            with (partial / file).open("w", newline="") as stream:
                writer = csv.DictWriter(stream, rows[0])
                writer.writeheader()
                writer.writerows(rows)
        draw_distributions(figures["pendulum_real_20hz"], partial / "distributions.png")
        draw_distances(channels, partial / "distances.png")
        draw_stalls(figures["vx300s_real_3hz"], partial / "stalls.png")
        (partial / "README.md").write_text(
            report(channels, stalls, ranks, options.seed, SIMULATED, WARM_UP, STRETCH)
        )
    return 0


def load(path: Path, setup: Setup) -> dict[str, np.ndarray]:
    """Read delays [s] by node name and connection key."""
    found = {}
    with np.load(path, allow_pickle=False) as arrays:
        for key in arrays.files:
            kind, source, *receiver = key.split("__")
            node = setup.publishers.get(source, source)
            found[node if kind == "comp" else f"{node}->{receiver[0]}"] = arrays[key].astype(np.float64)
    return found


def compare(key: str, first: np.ndarray, second: np.ndarray, law: Delay) -> dict[str, Any]:
    """Test the law fitted to the first half, and the first half itself, against the second.

    The Kolmogorov-Smirnov distance is that of the law's distribution function, free of the luck of a
    sample. Its significance is that of two samples of the effective sizes n / tau, tau the integrated
    autocorrelation time of the normal scores: neighbours repeat each other, so n samples tell less.
    """
    sizes = len(first) / correlation_time(first), len(second) / correlation_time(second)
    step = max(int(np.ceil(correlation_time(second))), 1)
    thinned = second[::step]
    draws = law.stream(1, 1.0).draw(np.random.default_rng(len(key)), len(first))[0]
    distances = model_distance(second, law), sample_distance(first, second)
    chance = [significance(distance, *sizes) for distance in distances]
    return {
        "channel": key,
        "n_first": len(first),
        "n_second": len(second),
        "effective_first": round(sizes[0], 1),
        "effective_second": round(sizes[1], 1),
        "components": len(getattr(law.marginal, "components", [0])),
        "autocorrelation": round(law.autocorrelation(1.0), 3),
        "mean_ms_second": round(float(second.mean()) * 1e3, 4),
        "mean_ms_model": round(law.mean * 1e3, 4),
        "ks_model": round(distances[0], 4),
        "p_model": round(chance[0], 4),
        "ks_halves": round(distances[1], 4),
        "p_halves": round(chance[1], 4),
        "p_model_independent": round(significance(distances[0], len(first), len(second)), 4),
        "p_anderson_darling": round(anderson_darling(draws[::step], thinned), 4),
        "ks_fit": round(model_distance(first, law), 4),
    }


def interleaved(delays: np.ndarray, rate: float) -> dict[str, Any]:
    """Fit every other stretch of a channel and test the stretches between: what drifts is in both."""
    even = np.arange(len(delays)) // max(int(STRETCH * rate), 1) % 2 == 0
    law = fit_mixture(delays[even])
    distance, time = model_distance(delays[~even], law), correlation_time(delays)
    sizes = even.sum(), (~even).sum()
    return {
        "ks_interleaved": round(distance, 4),
        "p_interleaved": round(significance(distance, *(size / time for size in sizes)), 4),
        "p_interleaved_independent": round(significance(distance, *sizes), 4),
    }


def correlation_time(delays: np.ndarray) -> float:
    """Return 1 + 2 sum rho_k, in samples, up to where a pair of correlations is negative; at least 1.

    Source: Geyer, Practical Markov chain Monte Carlo (1992), initial positive sequence.
    """
    scores = normal_scores(delays)
    spectrum = np.abs(np.fft.rfft(scores, 2 * len(scores))) ** 2
    covariance = np.fft.irfft(spectrum)[: len(scores)]
    pairs = (covariance / covariance[0])[: len(scores) // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0)
    return max(2.0 * float(pairs[: negative[0] if len(negative) else None].sum()) - 1.0, 1.0)


def model_distance(delays: np.ndarray, law: Delay) -> float:
    """Return the largest distance between a sample's and a law's distribution function."""
    ordered = np.sort(delays)
    below, n = law.cdf(ordered), len(ordered)
    return float(max((np.arange(1, n + 1) / n - below).max(), (below - np.arange(n) / n).max()))


def sample_distance(first: np.ndarray, second: np.ndarray) -> float:
    """Return the largest distance between the distribution functions of two samples."""
    points = np.concatenate([first, second])
    below = [np.searchsorted(np.sort(part), points, side="right") / len(part) for part in (first, second)]
    return float(np.abs(below[0] - below[1]).max())


def significance(distance: float, first: float, second: float) -> float:
    """Return the probability of a larger distance between samples of one law, of these effective sizes."""
    return float(kstwobign.sf(distance * np.sqrt(first * second / (first + second))))


def anderson_darling(first: np.ndarray, second: np.ndarray) -> float:
    """Return the significance of two thinned samples; the table ends at 0.001 and 0.25."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return float(anderson_ksamp([first, second]).pvalue)  # pyright: ignore[reportAttributeAccessIssue]


class Timed(Node):
    """A node of which only the timing counts."""

    def init(self, parameters, generator, batch):
        return {}

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1)

    def step(self, parameters, state, inputs):
        return state, torch.zeros(1, 1)


def simulate(
    name: str, setup: Setup, rates: Mapping[str, float], model: DelayModel, seed: int
) -> list[dict[str, np.ndarray]]:
    """Simulate recordings of the measured graph with a model; return their delays by channel."""
    nodes: list[Node] = []
    for key, law in model.laws.items():
        if "->" not in key:
            if key == setup.supervisor:
                nodes.append(Supervisor(key, round(rates[key], 3), initial_action=torch.zeros(1), delay=law))
            else:
                nodes.append(Timed(key, round(rates[key], 3), law))
    connections = [
        Connection(
            key.split("->")[0],
            key.split("->")[1],
            law,
            skip=key in setup.skipped,
            # The arm's actuator acts on a command of its controller, so that a stall of one delays both.
            blocking=key == "controller->armactuator",
        )
        for key, law in model.laws.items()
        if "->" in key
    ]
    graph = Graph(nodes, connections, setup.supervisor, correlations=model.correlations, stalls=model.stalls)
    steps = int(setup.duration * rates[setup.supervisor])
    timing = draw_timing(graph, np.random.default_rng([seed, *name.encode()]), steps, SIMULATED)
    recordings = []
    for row in range(SIMULATED):
        found = {}
        for n, node in enumerate(graph.nodes):
            start, end = timing.steps_of(n, row)
            found[node.name] = (end - start)[: len(end) - (node.name == setup.supervisor)] / timing.resolution
        for e, connection in enumerate(graph.connections):
            sent, received = timing.messages_of(e, row)
            found[connection.key] = (received - sent) / timing.resolution
        recordings.append(found)
    return recordings


def compare_stalls(
    delays: Mapping[str, np.ndarray],
    rates: Mapping[str, float],
    simulated: Sequence[Mapping[str, np.ndarray]],
    half: DelayModel,
    duration: float,
) -> dict[str, Any]:
    """Count stalls and who is hit by them in the measured and in the simulated recordings."""
    measured = seen(delays, rates)
    again = [stall for recording in simulated for stall in seen(recording, rates)]
    middle = 0.5 * duration
    return {
        "stalls": len(measured),
        "per_minute": round(60 * len(measured) / duration, 3),
        "per_minute_simulated": round(60 * len(again) / duration / len(simulated), 3),
        "nodes": sum("->" not in key for key in delays),
        "nodes_hit": round(float(np.mean([len(s.hit) for s in measured])), 2),
        "nodes_hit_simulated": round(float(np.mean([len(s.hit) for s in again])), 2) if again else "",
        "duration_ms": round(1e3 * float(np.mean([s.duration for s in measured])), 1),
        "duration_ms_simulated": round(1e3 * float(np.mean([s.duration for s in again])), 1) if again else "",
        "first_half": sum(s.time < middle for s in measured),
        "second_half": sum(s.time >= middle for s in measured),
        "second_half_predicted": round(sum(s.rate for s in half.stalls) * middle, 2),
    }


def seen(delays: Mapping[str, np.ndarray], rates: Mapping[str, float]) -> list:
    """Find stalls in the computations after the warm-up."""
    begin = {key: int(np.ceil(WARM_UP * rates[key])) for key in delays if "->" not in key}
    kept = {key: delays[key][first:] for key, first in begin.items()}
    times = {key: (begin[key] + np.arange(len(kept[key]))) / rates[key] for key in kept}
    return find_stalls(kept, times, TOLERANCE)


def compare_ranks(
    delays: Mapping[str, np.ndarray],
    halves: Sequence[Mapping[str, np.ndarray]],
    simulated: Sequence[Mapping[str, np.ndarray]],
    model: DelayModel,
) -> list[dict[str, Any]]:
    """Rank correlation of channels of one publisher: measured, in both halves, simulated."""
    rows = []
    for correlation in model.correlations:
        for i, a in enumerate(correlation.channels):
            for b in correlation.channels[:i]:
                again = [rank(recording[a], recording[b]) for recording in simulated]
                rows.append(
                    {
                        "channels": f"{b} | {a}",
                        "measured": round(rank(delays[a], delays[b]), 3),
                        "simulated": round(float(np.mean(again)), 3),
                        "first_half": round(rank(halves[0][a], halves[0][b]), 3),
                        "second_half": round(rank(halves[1][a], halves[1][b]), 3),
                    }
                )
    return rows


def rank(a: np.ndarray, b: np.ndarray) -> float:
    """Spearman's correlation of samples with the same number."""
    n = min(len(a), len(b))
    return float(spearmanr(a[:n], b[:n]).statistic)  # pyright: ignore[reportAttributeAccessIssue]


if __name__ == "__main__":
    sys.exit(main())
