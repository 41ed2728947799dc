"""Measured positions of the joints at any time of a window."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.windows import Windows
from deepkoco.systems import System


def positions_at(windows: Windows, system: System, window: np.ndarray, time: np.ndarray) -> Tensor:
    """Return the positions (J, K) of all joints [rad or m], linear between the samples of their channels.

    A joint that no channel of the window shows stays at the first guess of the window's state.

    Args:
        windows: The windows.
        system: The system with J joints.
        window: (K,) index of a window.
        time: (K,) times after its start [s].
    """
    result = windows.state[torch.from_numpy(window), : system.joints].T.clone()
    # Of several channels of a joint, the first that has samples in the window.
    shown = [(joint, c) for c, joint in enumerate(windows.shows) if joint < system.joints][::-1]
    for w in np.unique(window):
        mine = window == w
        for joint, c in shown:
            valid = windows.valid[w, c].numpy()
            if valid.any():
                at = np.interp(time[mine], windows.t[w, c].numpy()[valid], windows.value[w, c].numpy()[valid])
                result[joint, torch.from_numpy(mine)] = torch.from_numpy(at)
    return result
