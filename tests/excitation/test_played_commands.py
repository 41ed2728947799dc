"""Commands from a file, played as they stand there."""

import numpy as np
import pytest

from deepkoco.excitation.played import CommandFileError, PlayedCommands, load_commands
from deepkoco.systems import make_system, one_joint


def sequence(rate: float) -> PlayedCommands:
    return PlayedCommands(np.arange(20) / rate, np.arange(20.0))


def test_commands_faster_than_the_sensor_are_refused():
    with pytest.raises(CommandFileError, match=r"200 commands per second, .*100 samples.*--rate 100"):
        sequence(200.0).rate_on(100.0)


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_commands_play_at_their_own_rate(rate):
    played = sequence(rate)
    assert played.rate_on(100.0) == pytest.approx(rate)
    command = played.excitation()
    assert [command(k / rate, [0.0, 0.0]) for k in range(20)] == list(range(20))
    assert command(100.0, [0.0, 0.0]) == 19.0


def test_a_file_without_the_column_is_refused(tmp_path):
    path = tmp_path / "commands.csv"
    path.write_text("t,voltage\n0,1\n0.1,2\n")
    with pytest.raises(CommandFileError, match=r"commands\.csv.*torque"):
        load_commands(path, one_joint(make_system("rod_pendulum")))
