"""`deepkoco inspect --out` where only some channels are found: the sidecar has them, and marks the others."""

import numpy as np
import pandas as pd
import pytest

from deepkoco.cli.command_line import main
from deepkoco.logs.inspect.partial import OPEN
from deepkoco.logs.recording import LogError, read_log

T = np.arange(0.0, 6.0, 0.01)
PULSE = 1500.0 + np.round(400.0 * np.sign(np.sin(2.0 * T**1.2)))


@pytest.fixture
def log(tmp_path):
    # A pulse of 1100 to 1900 us drives the joint; its unit is that of no torque.
    frame = pd.DataFrame({"t": T, "theta": np.sin(T), "omega": np.cos(T), "pwm_us": PULSE})
    frame.to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv"


def test_what_was_found_is_written_and_the_rest_is_marked(log, capsys):
    sidecar = log.with_suffix(".yaml")
    assert main(["inspect", str(log), "--system", "torque_pendulum", "--out", str(sidecar)]) == 2
    said = capsys.readouterr().err
    assert f'has what was found: replace "{OPEN}" there' in said
    text = sidecar.read_text()
    assert 'No column fits torque. Columns that no channel has: "pwm_us".' in text
    with pytest.raises(LogError, match=f'column "{OPEN}" is missing'):
        read_log(log)
    # What the user writes: full pulses are +-2 N m.
    sidecar.write_text(text.replace(f"column: {OPEN}", "column: pwm_us\n    scale: 0.005\n    offset: -7.5"))
    recording = read_log(log)
    np.testing.assert_allclose(recording.channels["torque"].value, (PULSE - 1500.0) / 200.0, atol=1e-12)
    np.testing.assert_array_equal(recording.channels["theta"].value, np.sin(T))


def test_nothing_is_written_where_nothing_was_found(tmp_path):
    pd.DataFrame({"t": T, "pwm_us": PULSE, "rssi": -60.0 + np.sin(T)}).to_csv(
        tmp_path / "log.csv", index=False
    )
    sidecar = tmp_path / "log.yaml"
    assert (
        main(["inspect", str(tmp_path / "log.csv"), "--system", "torque_pendulum", "--out", str(sidecar)])
        == 2
    )
    assert not sidecar.exists()
