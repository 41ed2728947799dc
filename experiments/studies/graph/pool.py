"""A pool whose thermometer sits behind a pipe: PID alone, and with a Kalman filter that knows how old its readings are.

    python -m experiments.studies.graph.pool --out results/graph/pool

The delay of the pipe is its volume by the flow, which changes while the controller runs. Four controllers: PID on the
thermometer; PID on a Kalman filter that takes a reading to be of now, of a constant time ago, or of the time ago that
the measured flow tells. Each is tuned by itself, on episodes of its own, then all meet the same episodes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.envs.pool import PoolOptions, pool_graph, pool_start
from deepkoco.graph import BatchedRuntime, Graph, draw_timing
from deepkoco.systems.fluids import pool_parameters
from experiments.studies.graph.live_study import run_study
from experiments.studies.graph.pool_figures import draw_episode, draw_errors, film
from experiments.studies.graph.pool_machines import identified, same_in_every_runtime
from experiments.studies.graph.pool_report import report

if TYPE_CHECKING:
    from deepkoco.graph.drawing.style import Picture

STEPS = 360  # of 10 s
DT = 10.0
TUNING_SEED = 1000
START = 28.0  # [deg C]
GOALS = ((0.0, 29.0), (1200.0, 30.0))  # from when on [s], goal [deg C]
REFILL = {"refill_heat": 2e4, "refill_start": 2400.0, "refill_time": 300.0}
LEVELS = (0.12, 1.0)  # of the pump, log-uniform, each held for
HELD = (20, 60)  # steps
GAINS = (0.2, 0.4, 0.8, 1.6, 3.2, 6.4)
INTEGRAL_TIMES = (600.0, 1200.0, 2400.0, 4800.0, 9600.0)
DERIVATIVE_TIMES = (0.0, 60.0)
HEAT_NOISES = (2e3, 2e4, 2e5)
TUNED = ("gain", "integral_time", "derivative_time")
FILTERS = {"PID": "none", "filter, now": "now", "filter, constant": "constant", "filter, flow": "flow"}
MEASURES = ("mean_error_K", "overshoot_K", "error_after_refill_K", "estimation_error_K")


@dataclass(frozen=True)
class Episodes:
    """Episodes that all controllers meet.

    Attributes:
        pump: (steps, E) levels.
        timing_seed, noise_seed: Of their delays and their noise.
    """

    pump: Tensor
    timing_seed: int
    noise_seed: int

    @classmethod
    def draw(cls, seed: int, count: int) -> Episodes:
        """Pump levels that hold for a few minutes."""
        generator = np.random.default_rng(seed)
        pump = np.ones((STEPS, count))
        for episode in range(count):
            step = 0
            while step < STEPS:
                held = int(generator.integers(*HELD))
                pump[step : step + held, episode] = np.exp(generator.uniform(*np.log(LEVELS)))
                step += held
        return cls(torch.from_numpy(pump), *(int(n) for n in generator.integers(2**31, size=2)))

    @property
    def mean_delay(self) -> float:
        """Mean over time of volume by flow [s]."""
        volume, flow = pool_parameters()["world"]["pipe_volume"], pool_parameters()["pump"]["scale"]
        return float((volume / (flow * self.pump)).mean())


def goals() -> Tensor:
    """Goal (steps,) of each step [deg C]."""
    begins, values = np.array(GOALS).T
    return torch.from_numpy(values[np.searchsorted(begins, DT * np.arange(STEPS), "right") - 1])


def run(
    graph: Graph, episodes: Episodes, settings: dict[str, Tensor], pipe: float = 1.0
) -> dict[str, np.ndarray]:
    """Run the episodes with each of K settings of the controller.

    Args:
        graph: Of one filter.
        episodes: E of them.
        settings: Gain, integral and derivative time, (K,) each.
        pipe: Volume of the true pipe, as a multiple of what the filter knows.

    Returns:
        ``temperature``, ``estimate`` and ``delay``, (steps, K, E): after each step.
    """
    count, many = episodes.pump.shape[1], len(settings["gain"])
    batch = count * many
    parameters = pool_parameters()
    parameters["world"] |= {name: torch.tensor(value, dtype=torch.float64) for name, value in REFILL.items()}
    parameters["world"]["pipe_volume"] = pipe * parameters["world"]["pipe_volume"]
    parameters["pid"] = {name: value.repeat_interleave(count) for name, value in settings.items()}
    timing = draw_timing(graph, np.random.default_rng(episodes.timing_seed), STEPS, count, rows=count)
    runtime = BatchedRuntime(graph, timing, executor="fused")
    full = torch.full((batch,), START, dtype=torch.float64)
    # The same noise for every setting: an environment's depends on its own generator.
    seeds = np.random.default_rng(episodes.noise_seed).integers(2**31, size=count)
    generators = [torch.Generator().manual_seed(int(seeds[b % count])) for b in range(batch)]
    rows = np.arange(batch) % count
    state, _ = runtime.reset(parameters, generators, pool_start(graph, full, full), rows=rows)
    actions = torch.stack([goals()[:, None].expand(-1, batch), episodes.pump.repeat(1, many)], -1)
    _, taken = runtime.rollout(
        state, actions, record=["temperature", "goal", "observation", "transport_delay"]
    )
    shaped = {name: value.reshape(STEPS, many, count, -1).numpy() for name, value in taken.items()}
    return {
        "temperature": shaped["temperature"][..., 0],
        "estimate": (shaped["goal"] - shaped["observation"][..., 3:4])[..., 0],
        "delay": shaped["transport_delay"][..., 0],
    }


def measures(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What is reported of each episode, (K, E) by name [K].

    The mean distance from the goal over the episode, and after the refill has begun; the largest distance above the
    goal; and the root mean square of the estimate against the truth, after the first 10 minutes.
    """
    goal = goals().numpy()[:, None, None]
    off = found["temperature"] - goal
    refill = int(REFILL["refill_start"] / DT)
    wrong = found["estimate"][60:] - found["temperature"][60:]
    return {
        "mean_error_K": np.abs(off).mean(0),
        "overshoot_K": np.maximum(off, 0.0).max(0),
        "error_after_refill_K": np.abs(off[refill:]).mean(0),
        "estimation_error_K": np.sqrt((wrong**2).mean(0)),
    }


def tune(kind: str, episodes: Episodes) -> tuple[dict[str, float], float]:
    """The settings of one filter and its controller with the least mean error, and that error."""
    grid = torch.from_numpy(
        np.array([(g, i, d) for g in GAINS for i in INTEGRAL_TIMES for d in DERIVATIVE_TIMES])
    )
    settings: dict[str, Tensor] = {name: grid[:, column] for column, name in enumerate(TUNED)}
    tried = []
    for noise in HEAT_NOISES if kind != "none" else HEAT_NOISES[:1]:
        graph = graph_of(kind, {"heat_noise": noise}, episodes.mean_delay)
        errors = measures(run(graph, episodes, settings))["mean_error_K"].mean(1)
        best = int(errors.argmin())
        found = {name: float(value[best]) for name, value in settings.items()}
        tried.append((float(errors[best]), found if kind == "none" else {**found, "heat_noise": noise}))
    error, found = min(tried, key=lambda pair: pair[0])
    return found, error


def graph_of(kind: str, settings: dict[str, float], delay: float) -> Graph:
    """The pool with one filter and the controller."""
    options: dict[str, Any] = dict(settings)
    return pool_graph(PoolOptions(filter=kind, constant_age=delay, controlled=True, **options))


def study(arguments: argparse.Namespace) -> tuple[list[Picture], str]:
    """Tune, evaluate, identify, and run the same nodes in every runtime."""
    import pandas as pd

    tuning = Episodes.draw(TUNING_SEED, arguments.tuning_episodes)
    rows, tuned, shown = [], {}, {}
    for name, kind in FILTERS.items():
        tuned[name] = tune(kind, tuning)
        own = tuned[name][0]
        # The same kernel as in tuning: gains are parameters.
        graph = graph_of(kind, {k: v for k, v in own.items() if k not in TUNED}, tuning.mean_delay)
        settings = {key: torch.tensor([own[key]], dtype=torch.float64) for key in TUNED}
        pipes = {name: 1.0} | ({f"{name}, pipe 30 % larger": 1.3} if kind in ("constant", "flow") else {})
        for seed in range(arguments.seeds):
            episodes = Episodes.draw(seed, arguments.episodes)
            for label, pipe in pipes.items():
                found = run(graph, episodes, settings, pipe)
                if seed == 0 and pipe == 1.0:
                    shown[name] = {key: value[:, 0, 0] for key, value in found.items()}
                    shown[name]["pump"] = episodes.pump[:, 0].numpy()
                for key, value in measures(found).items():
                    rows += [
                        {"controller": label, "seed": seed, "episode": e, "measure": key, "value": float(v)}
                        for e, v in enumerate(value[0])
                    ]
    table = pd.DataFrame(rows)
    best = tuned["filter, flow"][0]
    volumes = identified(arguments.seeds)
    runtimes = same_in_every_runtime(best, arguments.wall_clock_steps)
    filmed = graph_of("flow", best, tuning.mean_delay)
    pictures = [
        draw_errors(table, MEASURES),
        draw_episode(shown, goals().numpy(), DT),
        film(filmed, shown["filter, flow"]["pump"], goals(), DT),
    ]
    grid = len(GAINS), len(INTEGRAL_TIMES), len(DERIVATIVE_TIMES), len(HEAT_NOISES)
    text = report(table, MEASURES, tuned, tuning.mean_delay, volumes, runtimes, grid, arguments)
    return pictures, text


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; return the exit status."""
    assert __doc__
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/graph/pool"))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=20, help="of each seed")
    parser.add_argument("--tuning-episodes", type=int, default=16)
    parser.add_argument("--wall-clock-steps", type=int, default=6, help="of 10 s, in real time")
    return run_study(argv, parser, study)


if __name__ == "__main__":
    sys.exit(main())
