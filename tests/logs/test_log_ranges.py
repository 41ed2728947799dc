"""check_units on angles with an implausible range, also if unwrapping takes their steps for turns."""

import math
from pathlib import Path

import numpy as np
import pytest

from deepkoco.logs.checks.channel_checks import check_units
from deepkoco.logs.recording import LogError
from deepkoco.logs.series import Series
from deepkoco.logs.sidecar import ChannelColumn, Column


def checked(value: np.ndarray) -> list[str]:
    t = 0.01 * np.arange(len(value))
    column = ChannelColumn(Column("theta", "rad"), "measurement", None)
    return check_units(Path("log.csv"), {"theta": Series(t, value, "rad", "measurement")}, {"theta": column})


SWING = np.sin(0.03 * np.arange(2000))


@pytest.mark.parametrize("factor", [300.0, 3000.0, 3e5])
def test_check_units_refuses_an_implausible_scale(factor):
    with pytest.raises(LogError, match="if it is in deg"):
        checked(factor * SWING)


def test_check_units_accepts_wrapped_angles_and_single_glitches():
    assert checked(np.mod(0.3 * np.arange(2000), 2 * math.pi)) == []
    wild = SWING.copy()
    wild[[3, 700]] = 1e6
    assert checked(wild) == []
