"""What the causes of the catalogue may look at when they choose their start values."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deepkoco.diagnose.causes import Hint
from deepkoco.identify.windows import Windows
from deepkoco.systems import System


def hint_for(system: System, windows: Windows, pushes: tuple[Mapping[str, float], ...]) -> Hint:
    """Commands, speeds and candidate pushes of some windows."""
    command = np.concatenate([c.value for c in windows.commands])
    speed = np.array([], dtype=float)
    if windows.value.shape[1] > 1 and bool(windows.valid[:, 1].any()):
        speed = windows.value[:, 1][windows.valid[:, 1]].numpy()
    elif len(windows):
        valid = windows.valid[:, 0]
        pairs = valid[:, 1:] & valid[:, :-1]
        gap = (windows.t[:, 0, 1:] - windows.t[:, 0, :-1])[pairs]
        speed = ((windows.value[:, 0, 1:] - windows.value[:, 0, :-1])[pairs] / gap).numpy()
    return Hint(system, command, speed, pushes)
