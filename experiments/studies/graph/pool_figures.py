"""Figures of the study of the pool, and its film."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.envs.pool import pool_start
from deepkoco.graph import BatchedRuntime, Graph, draw_timing
from deepkoco.systems.fluids import pool_parameters
from deepkoco.systems.fluids.pool_picture import draw_pool

if TYPE_CHECKING:
    import pandas as pd

    from deepkoco.graph.drawing.style import Picture

TITLES = {
    "mean_error_K": "distance from the goal [K]",
    "overshoot_K": "overshoot [K]",
    "error_after_refill_K": "distance after the refill [K]",
    "estimation_error_K": "error of the estimate, rms [K]",
}
FRAMES = 6


def draw_errors(table: pd.DataFrame, measures: Sequence[str]) -> Picture:
    """Mean over the seeds of each measure with its interval, and every seed as a dot."""
    from matplotlib.figure import Figure

    from deepkoco.graph.drawing.style import PALETTE, Picture, figure_style

    labels = list(dict.fromkeys(table.controller))
    by_seed = table.groupby(["controller", "measure", "seed"]).value.mean()
    with figure_style():
        figure = Figure(figsize=(10, 3.2), layout="constrained")
        for axes, key in zip(np.ravel(figure.subplots(1, len(measures), sharey=True)), measures, strict=True):
            for place, label in enumerate(labels):
                values = by_seed.loc[(label, key)].to_numpy()
                mean, low, high = mean_with_band(values)
                axes.plot(
                    values, np.full(len(values), place) + 0.18, ".", ms=3, color=PALETTE[place], alpha=0.6
                )
                axes.errorbar(
                    mean, place, xerr=[[mean - low], [high - mean]], fmt="o", ms=4, color=PALETTE[place]
                )
            axes.set(yticks=range(len(labels)), yticklabels=labels, xlim=(0.0, None))
            axes.set_xlabel(TITLES[key], fontsize=8)
        axes.invert_yaxis()  # the axes are shared: once for all
    return Picture("errors", figure, table)


def draw_episode(shown: dict[str, dict[str, np.ndarray]], goals: np.ndarray, dt: float) -> Picture:
    """The first episode of seed 0 under all controllers, with the delay of its pipe."""
    import pandas as pd
    from matplotlib.figure import Figure

    from deepkoco.graph.drawing.style import PALETTE, QUIET, Picture, figure_style

    minutes = dt * (1 + np.arange(len(goals))) / 60.0
    columns = {"time_min": minutes, "goal_degC": goals}
    with figure_style():
        figure = Figure(figsize=(9, 5.6), layout="constrained")
        top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 1.4))
        top.plot(minutes, goals, ":", color=QUIET, label="goal")
        for colour, (name, found) in zip(PALETTE, shown.items(), strict=False):
            top.plot(minutes, found["temperature"], color=colour, lw=1.3, label=name)
            middle.plot(minutes, found["estimate"] - found["temperature"], color=colour, lw=0.9)
            columns |= {
                f"{name}: temperature_degC": found["temperature"],
                f"{name}: estimate_degC": found["estimate"],
            }
        first = next(iter(shown.values()))
        bottom.plot(minutes, first["delay"], color=QUIET)
        columns["delay_s"] = first["delay"]
        top.set_ylabel("pool [°C]")
        top.legend(fontsize=8, ncols=2)
        middle.axhline(0.0, color=QUIET, lw=0.6)
        middle.set_ylabel("estimate - truth [K]")
        bottom.set(ylabel="delay [s]", xlabel="time [min]")
    return Picture("episode", figure, pd.DataFrame(columns))


def film(graph: Graph, pump: np.ndarray, goals: Tensor, dt: float) -> Picture:
    """A strip of an episode: the pool and its pipe, whose elements keep the temperature with which they entered.

    Args:
        graph: With a controller.
        pump: (steps,) levels.
        goals: (steps,) [deg C].
        dt: Time of a step [s].
    """
    import pandas as pd
    from matplotlib.figure import Figure

    from deepkoco.graph.drawing.style import Picture, figure_style

    parameters = pool_parameters()
    runtime = BatchedRuntime(
        graph, draw_timing(graph, np.random.default_rng(0), len(pump), 1), executor="eager"
    )
    start = torch.full((1,), 28.0, dtype=torch.float64)
    state, _ = runtime.reset({}, torch.Generator().manual_seed(0), pool_start(graph, start, start))
    wanted = [
        round(step) for step in np.linspace(4, 30, FRAMES)
    ]  # the first rise, in which the pipe shows most
    frames, rows = [], []
    for step in range(max(wanted) + 1):
        action = torch.stack([goals[step], torch.tensor(pump[step], dtype=torch.float64)])[None]
        state, _ = runtime.step(state, action)
        if step not in wanted:
            continue
        world = {name: value[0].numpy() for name, value in state.nodes["world"].items()}
        heat, flow = (
            float(state.nodes[name]["delivered"][0]) / float(parameters[name]["scale"])
            for name in ("heater", "pump")
        )
        pool, goal = float(world["temperature"]), float(goals[step])
        frames.append(
            draw_pool(pool, world["edges"], world["values"][:, 0], heat, flow, goal, 384, limits=(27.8, 29.4))
        )
        rows.append({"time_s": dt * (step + 1), "pool_degC": pool, "heater": heat, "pump": flow})
    with figure_style():
        figure = Figure(figsize=(2.6 * FRAMES, 2.9), layout="constrained")
        for axes, frame, row in zip(np.ravel(figure.subplots(1, FRAMES)), frames, rows, strict=True):
            axes.imshow(frame)
            axes.set_title(f"{row['time_s']:.0f} s", fontsize=9)
            axes.axis("off")
    return Picture("film", figure, pd.DataFrame(rows))
