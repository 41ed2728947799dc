"""Cells: the last outputs of a node, the output of step k in cell k % depth."""

import numpy as np
import torch
from torch import Tensor


def where(mask: Tensor, new: Tensor, old: Tensor) -> Tensor:
    """Take environments from `new` where the mask (B,) says so, else from `old`; scalars may meet (B, ...)."""
    if new is old or (new.ndim == old.ndim == 0 and torch.equal(new, old)):
        return new
    dimensions = max(new.ndim, old.ndim, 1)
    return torch.where(mask.reshape(-1, *(1,) * (dimensions - 1)), new, old)


def write(cells: tuple[Tensor, ...], output: Tensor, seq: np.ndarray) -> tuple[Tensor, ...]:
    """Put outputs of steps `seq` into their cells; (B,), or (1,) if the same for all; -1 writes nothing."""
    depth = len(cells)
    written = list(cells)
    cell = np.where(seq >= 0, seq % depth, -1)
    if (cell == cell[0]).all():
        written[cell[0]] = output
        return tuple(written)
    for place in sorted(set(cell.tolist()) - {-1}):
        mask = torch.from_numpy(cell == place).to(output.device)
        written[place] = where(mask, output, cells[place])
    return tuple(written)


def read(cells: tuple[Tensor, ...], seq: np.ndarray) -> Tensor:
    """Gather the outputs of steps `seq`, (B, window) or (1, window) if the same for all."""
    place = seq % len(cells)
    if len(place) == 1 or (place == place[0]).all():
        chosen = [cells[i] for i in place[0].tolist()]
        return chosen[0].unsqueeze(1) if len(chosen) == 1 else torch.stack(chosen, dim=1)
    batch, window = place.shape
    flat = torch.from_numpy((place * batch + np.arange(batch)[:, None]).ravel()).to(cells[0].device)
    return torch.cat(cells).index_select(0, flat).unflatten(0, (batch, window))


def resize(cells: tuple[Tensor, ...], depth: int, written: np.ndarray) -> tuple[Tensor, ...]:
    """Move the last outputs into `depth` cells, so that step k is again in cell k % depth.

    Args:
        cells: (B, ...) each.
        depth: number of cells wanted.
        written: (B,) number of outputs that have been sent.
    """
    if len(cells) == depth:
        return cells
    cell = np.arange(depth)
    # The latest step that belongs into each cell; what has left the old cells is not needed any more.
    seq = written[:, None] - 1 - (written[:, None] - 1 - cell) % depth
    return read(cells, seq).unbind(dim=1)


def rotate(stacked: Tensor, by: np.ndarray) -> Tensor:
    """Stacked cells (B, depth, ...) in another order: place i takes what was in place (i + by) % depth.

    Args:
        stacked: cells side by side.
        by: (B,) of each environment.
    """
    batch, depth = stacked.shape[:2]
    places = (np.arange(depth) + by[:, None]) % depth
    if (places == places[0]).all():
        order = places[0].tolist()
        return stacked if order == sorted(order) else stacked[:, order]
    rows = torch.arange(batch, device=stacked.device)[:, None]
    return stacked[rows, torch.from_numpy(places).to(stacked.device)]
