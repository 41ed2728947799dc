"""The README of the study of the pool."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from deepkoco.agent.mean_interval import mean_with_band
from experiments.studies.graph.pool_figures import TITLES

if TYPE_CHECKING:
    import pandas as pd

BEST = "filter, flow"


def report(
    table: pd.DataFrame,
    measures: Sequence[str],
    tuned: Mapping[str, tuple[dict[str, float], float]],
    delay: float,
    volumes: pd.DataFrame,
    runtimes: pd.DataFrame,
    grid: tuple[int, ...],
    arguments: argparse.Namespace,
) -> str:
    """Write it.

    Args:
        table: A row for each controller, seed, episode and measure.
        measures: Columns of the tables.
        tuned: Settings of each controller and its error in tuning.
        delay: The constant delay [s].
        volumes, runtimes: As of `experiments.studies.graph.pool_machines`.
        grid: Number of gains, integral times, derivative times and densities that were tried.
        arguments: Of the command.
    """
    by_seed = table.groupby(["controller", "measure", "seed"]).value.mean().unstack("seed")
    labels = list(dict.fromkeys(table.controller))

    def of(label: str, key: str) -> np.ndarray:
        return by_seed.loc[(label, key)].to_numpy()

    values = _rows(labels, measures, of)
    others = [label for label in labels if label != BEST]
    differences = _rows(others, measures, lambda label, key: of(label, key) - of(BEST, key))
    head = "| | " + " | ".join(TITLES[key] for key in measures) + " |\n|" + "---|" * (1 + len(measures))
    settings = "\n".join(
        f"| {name} | {own['gain']:g} | {own['integral_time']:g} | {own['derivative_time']:g} | {_noise(own)} "
        f"| {error:.3f} |"
        for name, (own, error) in tuned.items()
    )
    found = "\n".join(
        f"| {row['seed']} | {_litres(row, 'true')} | {_litres(row, 'value')} [{_litres(row, 'low')}, "
        f"{_litres(row, 'high')}] | {row['seconds']:.1f} |"
        for row in volumes.to_dict("records")
    )
    clocks = "\n".join(
        f"| {row['runtime']} | {row['simulated_s']:g} | {row['real_s']:.1f} | {row['difference_K']:.4f} | "
        f"{row['replay']} |"
        for row in runtimes.to_dict("records")
    )
    seeds, episodes, tuning = arguments.seeds, arguments.episodes, arguments.tuning_episodes
    return f"""# A pool whose thermometer sits behind a pipe

`python -m experiments.studies.graph.pool --seeds {seeds} --episodes {episodes} --tuning-episodes {tuning}`

What the study is about: [docs/pool.md](../../../docs/pool.md). The delay of the reading is 60 l by the flow, 40 to
333 s. The pump changes every 200 to 600 s to a level between 0.12 and 1, drawn log-uniformly. An episode lasts an
hour: the pool has 28 °C, the goal is 29 °C, and after 20 minutes 30 °C; after 40 minutes fresh water takes 20 kW for 5
minutes. {seeds} seeds of {episodes} episodes each; a value is the mean over the seeds with its 95 % interval
(Student's t over the means of the seeds). All controllers meet the same episodes. Most of the distance is the rise at
full heat, 0.17 K a minute at best.

{head}
{values}

The "estimate" of PID alone is the reading. Where the pipe is 30 % larger it holds 78 l, and the filter believes in 60.
Differences to the filter that knows the flow, seed by seed (positive: that filter is better):

{head}
{differences}

![errors](errors.png)

![episode](episode.png)

![film](film.png)

Each controller was tuned by itself, for the least mean distance on {tuning} episodes of another seed: {grid[0]} gains,
{grid[1]} integral times, {grid[2]} derivative times, and for a filter {grid[3]} densities of its unknown heat. The
constant delay is the mean of these episodes over time, {delay:.0f} s.

| | gain [1/K] | integral time [s] | derivative time [s] | unknown heat [W2/s] | mean distance there [K] |
|---|---|---|---|---|---|
{settings}

## The volume of the pipe from a log

A pool with a pipe of another volume is recorded for an hour, with a changing pump and heater and a noise of 0.05 K.
`fit_graph` seeks `world.pipe_volume` between 20 and 120 l (CMA-ES, 16 candidates, 25 generations).

| seed | true [l] | found [l], 95 % | processor time [s] |
|---|---|---|---|
{found}

## The same nodes in every runtime

The filter that knows the flow and its PID, goal 29 °C. The difference is the largest of the pool's temperature to that
in the simulated runtime.

| runtime | simulated [s] | real [s] | difference [K] | replay in the batched runtime |
|---|---|---|---|---|
{clocks}"""


def _rows(labels: Sequence[str], measures: Sequence[str], of: Callable[[str, str], np.ndarray]) -> str:
    cells = ((label, [mean_with_band(of(label, key)) for key in measures]) for label in labels)
    return "\n".join(
        f"| {label} | " + " | ".join(f"{mean:.3f} [{low:.3f}, {high:.3f}]" for mean, low, high in row) + " |"
        for label, row in cells
    )


def _noise(settings: Mapping[str, float]) -> str:
    return f"{settings['heat_noise']:g}" if "heat_noise" in settings else ""


def _litres(row: Mapping[str, Any], name: str) -> str:
    return f"{1e3 * row[f'{name}_m3']:.2f}"
