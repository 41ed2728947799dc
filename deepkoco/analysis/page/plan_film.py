"""A clip of the controller with its plan: shadows of the planned future over the frame, and cost curves beside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from deepkoco.analysis.measures.replays import FilmedEpisode, Future
from deepkoco.output.colours import COLOURS
from deepkoco.output.picture import house_style

SHADOW_COLOUR = tuple(round(255 * c) for c in to_rgb(COLOURS["DeepKoCo"]))
DIFFERENT = 24  # grey levels from the background
CHART = (360, 256)  # width and height [pixels]
CONTROLS = 32  # empty rows below, where players lay their controls over the picture
Curve = tuple[Callable[[float, float], tuple[int, int]], np.ndarray]


@dataclass(frozen=True)
class PlanFilm:
    """A film and the numbers in it.

    Attributes:
        frames: uint8 pictures of one size, the scene and the curves beside each other.
        tall: The same for a phone, the curves below the scene.
        rate: Frames per second, so that the film runs in real time.
        table: One row per planned step that is drawn.
    """

    frames: list[np.ndarray]
    tall: list[np.ndarray]
    rate: float
    table: pd.DataFrame


def shadow_steps(horizon: int) -> list[int]:
    """The steps of a plan whose shadows are drawn: a third, two thirds and all of it."""
    return sorted({max(1, round(horizon * part)) for part in (1 / 3, 2 / 3, 1.0)})


def make_film(episode: FilmedEpisode, futures: dict[int, Future], time_step: float) -> PlanFilm:
    """Draw the film.

    Args:
        episode: The episode.
        futures: By step k, what the true system does under the plan made there, with pictures at `shadow_steps`.
        time_step: Seconds per step.

    Returns:
        One frame for every key of ``futures``.
    """
    steps = sorted(futures)
    background = still_background(
        [*episode.scenes, *(s for future in futures.values() for s in future.scenes)]
    )
    predicted = [episode.plans[k].costs for k in steps]
    top = 1.1 * max(float(episode.costs.max()), float(np.quantile(np.concatenate(predicted), 0.98)), 1e-9)
    seconds = len(episode.costs) * time_step
    place, canvas = _chart(seconds, top)
    frames, tall, rows = [], [], []
    for k in steps:
        future = futures[k]
        frame = draw_shadows(np.array(episode.frames[k]), episode.scenes[k], future.scenes, background)
        chart = canvas.copy()
        time = np.arange(len(episode.costs)) * time_step
        _line(chart, place, time[: k + 1], episode.costs[: k + 1], COLOURS["measured"], 2)
        ahead = (k + np.arange(len(episode.plans[k].costs))) * time_step
        _line(chart, place, ahead, episode.plans[k].costs, COLOURS["DeepKoCo"], 2)
        _line(chart, place, ahead[1 : len(future.costs) + 1], future.costs, COLOURS["reference"], 2)
        frames.append(_beside(frame, chart))
        tall.append(_above(frame, chart))
        rows += [
            {
                "planned_at_step": k,
                "steps_ahead": h,
                "predicted_cost": episode.plans[k].costs[h],
                "cost_of_the_true_system_under_the_plan": future.costs[h - 1]
                if h <= len(future.costs)
                else np.nan,
                "cost_paid": episode.costs[k + h] if k + h < len(episode.costs) else np.nan,
            }
            for h in range(1, len(episode.plans[k].costs))
        ]
    stride = steps[1] - steps[0] if len(steps) > 1 else 1
    return PlanFilm(frames, tall, 1.0 / (stride * time_step), pd.DataFrame(rows))


def still_background(scenes: Sequence[np.ndarray], count: int = 15) -> np.ndarray:
    """What the scenes show where nothing moves: the median of those that differ most from each other.

    A median over time would keep what rests for most of an episode.

    Args:
        scenes: uint8 (height, width, 3) each.
        count: How many are chosen, each the farthest from all chosen before.

    Returns:
        (height, width, 3).
    """
    small = np.stack([cv2.resize(s, (32, 32), interpolation=cv2.INTER_AREA) for s in scenes]).astype(
        np.float32
    )
    small = small.reshape(len(scenes), -1)
    chosen, nearest = [0], np.full(len(scenes), np.inf)
    for _ in range(min(count, len(scenes)) - 1):
        nearest = np.minimum(nearest, np.square(small - small[chosen[-1]]).sum(-1))
        if nearest.max() == 0.0:  # the rest are repetitions
            break
        chosen.append(int(nearest.argmax()))
    return np.median(np.stack([scenes[i] for i in chosen]), axis=0)


def draw_shadows(
    frame: np.ndarray, scene: np.ndarray, futures: Sequence[np.ndarray], background: np.ndarray
) -> np.ndarray:
    """Tint where something will be: the farther ahead, the fainter.

    Args:
        frame: Picture to draw on, uint8 (height, width, 3); it is changed.
        scene: The same moment without distractors, uint8, not larger than the frame.
        futures: Pictures of the future, the nearest first, as large as the scene.
        background: What the scene shows where nothing moves, as large as the scene.

    Returns:
        The frame.
    """
    height, width = scene.shape[:2]
    part = frame[:height, :width].astype(np.float64)
    present = _differs(scene, background)
    for i in reversed(range(len(futures))):
        strength = 0.75 * (1.0 - i / (len(futures) + 0.5))
        mask = (_differs(futures[i], background) & ~present)[..., None]
        part = np.where(mask, (1.0 - strength) * part + strength * np.array(SHADOW_COLOUR), part)
    frame[:height, :width] = part.round().astype(np.uint8)
    return frame


def _differs(picture: np.ndarray, background: np.ndarray) -> np.ndarray:
    return np.abs(picture.astype(np.float64) - background).max(-1) > DIFFERENT


def _chart(seconds: float, top: float) -> tuple[Callable[[float, float], tuple[int, int]], np.ndarray]:
    """Empty axes as a picture, and where a point of them lies in it."""
    width, height = CHART
    with house_style():
        figure = Figure(figsize=(width / 100, height / 100), dpi=100)
        canvas = FigureCanvasAgg(figure)
        axes = figure.subplots()
        # A square root shows the small costs of staying at the goal beside the large ones of getting there.
        axes.set_yscale("function", functions=(lambda y: np.sqrt(np.maximum(y, 0.0)), np.square))
        axes.set(xlim=(0.0, seconds), ylim=(0.0, top))
        axes.set_xlabel("time [s]", fontsize=8)
        axes.set_ylabel("cost per step", fontsize=8)
        axes.tick_params(labelsize=7)
        for colour, label in (
            ("measured", "paid so far"),
            ("DeepKoCo", "planned, as the model predicts it"),
            ("reference", "true system under the same plan"),
        ):
            axes.plot([], [], color=COLOURS[colour], label=label)
        axes.legend(loc="upper right", fontsize=7)
        canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[..., :3].copy()
    transform = axes.transData

    def place(x: float, y: float) -> tuple[int, int]:
        column, row = transform.transform((x, min(max(y, 0.0), top)))
        return round(16 * column), round(16 * (picture.shape[0] - row))

    return place, picture


def _line(
    chart: np.ndarray, place: Callable[[float, float], tuple[int, int]], x: np.ndarray, y: np.ndarray,
    colour: str, thickness: int,
) -> None:  # fmt: skip
    points = np.array([place(a, b) for a, b in zip(x, y, strict=False)], np.int32)
    rgb = tuple(round(255 * c) for c in to_rgb(colour))
    if len(points) > 1:
        cv2.polylines(chart, [points.reshape(-1, 1, 2)], False, rgb, thickness, cv2.LINE_AA, 4)


def _beside(frame: np.ndarray, chart: np.ndarray) -> np.ndarray:
    """Frame and chart side by side; sizes are made even, as video needs them."""
    height = max(frame.shape[0], chart.shape[0]) + CONTROLS
    parts = []
    for picture in (frame, chart):
        canvas = np.full((height, picture.shape[1], 3), 255, np.uint8)
        canvas[: picture.shape[0]] = picture
        parts.append(canvas)
    return _even(np.concatenate(parts, axis=1))


def _above(frame: np.ndarray, chart: np.ndarray) -> np.ndarray:
    """Frame above the chart, as wide as it."""
    width = chart.shape[1]
    height = round(frame.shape[0] * width / frame.shape[1])
    scaled = cv2.resize(frame, (width, height), interpolation=cv2.INTER_LINEAR)
    return _even(np.concatenate([scaled, chart, np.full((CONTROLS, width, 3), 255, np.uint8)]))


def _even(picture: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2])
