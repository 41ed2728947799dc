"""Start values of a push at a body: when a force at it lowers chi2 most, and that force."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch

from deepkoco.diagnose.residuals.residuals import MissingTorque
from deepkoco.fit.simulate.push import AXES, LONGEST
from deepkoco.systems import Parameter, System

WIDTHS = (1, 2, 3, 4, 6)  # durations of a push at its starts, in slots


class Run(NamedTuple):
    """A time in which a constant force acts.

    Attributes:
        width: How many slots of one window, or 0 and how many windows.
        log: Its log.
        start: In the log's time [s].
        duration: [s].
        force: (A,) the force [N] that lowers half of chi2 most, under the prior of forces.
        fall: By how much.
    """

    width: tuple[int, int]
    log: float
    start: float
    duration: float
    force: np.ndarray
    fall: float


def pushes_of_bodies(system: System, missing: Sequence[MissingTorque]) -> tuple[dict[str, float], ...]:
    """Return starts of a push at each body, by their short names; the best one of each duration.

    Args:
        system: The system.
        missing: Missing load of each joint; empty, or without what they are together, where no body can be pushed.
    """
    if not missing or missing[0].together is None:
        return ()
    return tuple(push for index in range(len(system.push_places)) for push in _at(system, index, missing[0]))


def falls_at(system: System, index: int, missing: MissingTorque) -> dict[tuple[int, int], float]:
    """Return the largest fall of chi2 by a push at one body, of each duration: slots of a window, or windows.

    Args:
        system: The system.
        index: Which of its places of a push.
        missing: Missing load of any joint, with what they are together.
    """
    return {width: fall for width, (fall, _) in _best_at(system, index, missing).items()}


def _at(system: System, index: int, missing: MissingTorque) -> list[dict[str, float]]:
    return [push for _, push in _best_at(system, index, missing).values()]


def _best_at(
    system: System, index: int, missing: MissingTorque
) -> dict[tuple[int, int], tuple[float, dict[str, float]]]:
    together = missing.together
    assert together is not None
    declared = {p.name: p for p in system.push_places[index].parameters}
    axes = [axis for axis in AXES if axis in declared]
    prior = np.diag([declared[axis].prior_sd ** -2.0 for axis in axes])
    positions = [torch.from_numpy(q) for q in together.positions]
    best: dict[tuple[int, int], tuple[float, dict[str, float]]] = {}
    for along in _points(declared.get("along")):
        given = system.loads_of_push(index, torch.tensor((along, 0.0, 0.0), dtype=torch.float64), positions)
        loads = given.numpy()[[AXES.index(axis) for axis in axes]]  # (A, J, W, K)
        slope = np.einsum("ajwk,wjk->wka", loads, together.slope)
        curvature = np.einsum("ajwk,wjkil,biwl->wkalb", loads, together.curvature, loads, optimize=True)
        own = {"along": along} if "along" in declared else {}
        for run in (*_in_windows(missing, slope, curvature, prior), *_over(missing, slope, curvature, prior)):
            if run.width not in best or run.fall > best[run.width][0]:
                sizes = dict(zip(axes, run.force.tolist(), strict=True))
                when = {"start": run.start, "duration": run.duration, "log": run.log, "place": float(index)}
                best[run.width] = (
                    run.fall,
                    {"torque": 0.0, **dict.fromkeys(AXES, 0.0), **sizes, **own, **when},
                )
    return best


def _best(
    slope: np.ndarray, curvature: np.ndarray, allowed: np.ndarray | None = None
) -> tuple[int, int, np.ndarray, float]:
    """Indices of the entry (m, n, A) that falls most, with its force and its fall; of those (m, n) that are allowed."""
    force = np.linalg.solve(curvature, slope[..., None])[..., 0]
    fall = (slope * force).sum(-1)
    fall = fall if allowed is None else np.where(allowed, fall, -np.inf)
    i, k = np.unravel_index(int(np.argmax(fall)), fall.shape)
    return int(i), int(k), force[i, k], float(fall[i, k])


def _in_windows(
    missing: MissingTorque, slope: np.ndarray, curvature: np.ndarray, prior: np.ndarray
) -> Iterator[Run]:
    """Slots in a row of one window, the best ones of each width."""
    slots = slope.shape[1]
    for width in (w for w in WIDTHS if w <= slots):
        starts = range(slots - width + 1)
        g = np.stack([slope[:, k : k + width].sum(1) for k in starts], 1)
        h = np.stack([curvature[:, k : k + width, :, k : k + width].sum((1, 3)) for k in starts], 1)
        w, k, force, fall = _best(g, h + prior)
        start = float(missing.time[w, k] - 0.5 * missing.slot)
        yield Run((width, 0), float(missing.log[w]), start, width * missing.slot, force, fall)


def _over(
    missing: MissingTorque, slope: np.ndarray, curvature: np.ndarray, prior: np.ndarray
) -> Iterator[Run]:
    """From a slot of one window of a log to a slot of a later one, through what is between them."""
    slots = slope.shape[1]
    ends = np.arange(slots)
    tail_g, tail_h = _parts(slope, curvature, [slice(k, None) for k in ends])
    head_g, head_h = _parts(slope, curvature, [slice(0, slots - k) for k in ends])
    g, h = slope.sum(1), curvature.sum((1, 3))
    begin = missing.time[:, 0] - 0.5 * missing.slot
    order = np.lexsort((begin, missing.log))
    for at, first in enumerate(order):
        between = np.zeros_like(g[0]), np.zeros_like(h[0])
        for number, last in enumerate(order[at + 1 :], 2):
            whole = float(begin[last] - begin[first]) + slots * missing.slot
            lasts = whole - (ends[:, None] + ends) * missing.slot
            if missing.log[last] != missing.log[first] or lasts.min() > LONGEST:
                break
            i, k, force, fall = _best(
                tail_g[:, None, first] + between[0] + head_g[None, :, last],
                tail_h[:, None, first] + between[1] + head_h[None, :, last] + prior,
                lasts <= LONGEST,
            )
            start = float(begin[first] + ends[i] * missing.slot)
            yield Run((0, number), float(missing.log[first]), start, float(lasts[i, k]), force, fall)
            between = between[0] + g[last], between[1] + h[last]


def _parts(slope: np.ndarray, curvature: np.ndarray, parts: Sequence[slice]) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (E, W, A) and curvatures (E, W, A, A) of these slots of each window together."""
    g = np.stack([slope[:, part].sum(1) for part in parts])
    return g, np.stack([curvature[:, part, :, part].sum((1, 3)) for part in parts])


def _points(along: Parameter | None) -> tuple[float, ...]:
    """Points along a link at which a push is tried: its centre of mass, and between it and both ends."""
    return (0.0,) if along is None else (0.0, 0.5 * along.low, 0.5 * along.high)
