"""Advice about commands that take few values."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose.verdict.advice import level_advice
from deepkoco.fit.data.windows import cut_windows
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system
from deepkoco.systems.channel import Channel


def _windows(command: np.ndarray):
    t = np.arange(len(command)) * 0.01
    angle = np.sin(t)
    system = make_system("pendulum")
    (channel,), measured = system.commands, system.measurements[0]
    series = {
        channel.name: Series(t, command, channel.unit, "command"),
        measured.name: Series(t, angle, measured.unit, "measurement"),
    }
    return cut_windows([Recording(series)], system, 0.5), system


class Undriven:
    """A system of which no log must show the command."""

    def __init__(self, channel: Channel) -> None:
        self.commands, self.command_joints = (replace(channel, default=0.0),), (0,)


@pytest.mark.parametrize(("levels", "told"), [(2, True), (200, False)])
def test_level_advice_tells_of_few_levels(levels, told):
    windows, system = _windows(np.resize(np.linspace(-0.1, 0.1, levels), 400))
    assert bool(level_advice(windows, system)) is told


def test_level_advice_is_silent_about_a_joint_that_nothing_drives():
    windows, system = _windows(np.zeros(400))
    assert level_advice(windows, system)
    assert level_advice(windows, Undriven(system.commands[0])) == ()
