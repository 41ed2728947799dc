"""Windows of half the length: the cost of a shorter window has fewer minima."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from deepkoco.fit.data.unseen_positions import carried_on
from deepkoco.fit.data.wander import Wander
from deepkoco.fit.data.way_before import way_after
from deepkoco.fit.data.windows import Windows, first_state


def halved(windows: Windows) -> Windows:
    """Split each window into two halves; the first half of window w has the index 2 w.

    Their steps are those of the windows, which begin at commands. Where their number is odd, the second half is the
    longer one, and the first goes on beyond its last sample for a step.
    """
    if windows.steps == 1:
        windows = replace(windows, step=0.5 * windows.step, steps=2)
    half = windows.step * (windows.steps // 2)
    joints = windows.state.shape[1] // 2
    parts = []
    for w in range(len(windows)):
        for k in (0, 1):
            inside = windows.valid[w] & ((windows.t[w] >= half) if k else (windows.t[w] < half))
            t = torch.where(inside, windows.t[w] - k * half, 0.0)
            # Samples of the other half follow as padding.
            order = torch.argsort((~inside).to(torch.int8), dim=-1, stable=True)
            pick = [x.gather(-1, order) for x in (t, windows.value[w], inside)]
            t, value, valid = (x.numpy() for x in pick)
            state = first_state(t, value, valid, windows.shows, joints)
            guess, *shown = (x[w].numpy() for x in (windows.state, windows.t, windows.value, windows.valid))
            for joint, position in carried_on(guess, *shown, shows=windows.shows, until=k * half).items():
                state[joint] = position
            parts.append((*pick, state, order))
    size = int(max((part[2].sum(-1).max() for part in parts), default=0))
    return replace(
        windows,
        log=np.repeat(windows.log, 2),
        t0=(windows.t0[:, None] + half * np.arange(2)).ravel(),
        steps=windows.steps - windows.steps // 2,
        t=torch.stack([part[0][:, :size] for part in parts]),
        value=torch.stack([part[1][:, :size] for part in parts]),
        valid=torch.stack([part[2][:, :size] for part in parts]),
        state=torch.from_numpy(np.array([part[3] for part in parts])),
        rests=np.repeat(windows.rests, 2),
        doubt=None if windows.doubt is None else windows.doubt.repeat_interleave(2, 0),
        way=None if windows.way is None else _ways_of_halves(windows, half),
        wander=None
        if windows.wander is None
        else _wander_of_halves(windows.wander, [p[4] for p in parts], size),
    )


def _wander_of_halves(wander: Wander, orders: list[torch.Tensor], size: int) -> Wander:
    """Noise before the second half moves its initial state, which is free."""
    moves = [
        wander.moves[k // 2].gather(1, order[:, :size, None].expand(-1, -1, wander.moves.shape[-1]))
        for k, order in enumerate(orders)
    ]
    return replace(wander, moves=torch.stack(moves))


def _ways_of_halves(windows: Windows, half: float) -> torch.Tensor:
    """(2 W, J, P): the second half of a window begins after the way of the first."""
    assert windows.way is not None
    joints, before = windows.state.shape[1] // 2, windows.way.numpy()
    shown = [(c, s) for c, s in enumerate(windows.shows) if s < joints]
    result = []
    for w, way in enumerate(before):
        first = (windows.valid[w] & (windows.t[w] < half)).numpy()
        value = windows.value[w].numpy()
        between = {s: value[c, first[c]] for c, s in shown}
        result += [way, way_after(way, windows.unseen, between)]
    return torch.from_numpy(np.array(result).reshape(-1, *before.shape[1:]))
