"""The sidecar that is proposed for a wheel that turns many times can be read as it is."""

import numpy as np
import pandas as pd
import pytest

from deepkoco.cli import main
from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import propose, survey_log
from deepkoco.logs.inspect.choice import mapping_of
from deepkoco.logs.recording import read_log
from deepkoco.systems import any_system

WHEEL = """
from deepkoco import Channel, Parameter, System


class Wheel(System):
    name = "wheel"
    joint_names, joint_units = ("wheel",), ("rad",)
    parameters = (Parameter("inertia", 0.045, "kg m2", 0.005, 0.5, 0.001, "J"),)
    commands = (Channel("motor", "N m", "command", -1.0, 1.0),)
    measurements = (
        Channel("wheel_angle", "rad", "measurement", noise_sd=5e-4, angle=True),
        Channel("wheel_speed", "rad/s", "measurement", noise_sd=0.05),
    )

    def accelerations(self, p):
        return lambda motion: ((motion.efforts[0] + motion.load(0)) / p["inertia"],)
"""
T = np.arange(0.0, 20.0, 0.01)
TORQUE = 0.4 * np.sign(np.sin(0.7 * T)) + 0.1
SPEED = np.concatenate([[0.0], np.cumsum(TORQUE[:-1] / 0.045) * 0.01])
ANGLE = np.concatenate([[0.0], np.cumsum(0.5 * (SPEED[1:] + SPEED[:-1])) * 0.01])


@pytest.fixture
def wheel(tmp_path):
    (tmp_path / "robot.py").write_text(WHEEL)
    return str(tmp_path / "robot.py") + ":Wheel"


def written(tmp_path, angle, speed):
    columns = {"t_s": T, "wheel_angle_rad": angle, "wheel_speed_rad_s": speed, "motor_cmd_Nm": TORQUE}
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv"


def test_a_wheel_that_turns_many_times_is_read_from_the_proposed_sidecar(tmp_path, wheel, capsys):
    assert np.ptp(ANGLE) > 300.0
    log = written(tmp_path, ANGLE, SPEED)
    assert main(["inspect", str(log), "--system", wheel]) == 0
    # The hint names the system as the user did.
    assert f"--system{wheel}--out" in "".join(capsys.readouterr().out.split())
    assert main(["inspect", str(log), "--system", wheel, "--out", str(tmp_path / "log.yaml")]) == 0
    read = read_log(log).channels["wheel_angle"]
    np.testing.assert_allclose(read.value, ANGLE)


@pytest.mark.parametrize(("angle", "speed"), [(ANGLE, 57.3 * SPEED), (0.01 * ANGLE, 0.01 * SPEED)])
def test_an_angle_is_not_confirmed_where_its_speed_differs_or_nothing_is_in_doubt(
    tmp_path, wheel, angle, speed
):
    found = survey_log(open_log(written(tmp_path, angle, speed)))
    mapping = mapping_of(found, propose(found, any_system(wheel)).proposal)
    assert not any(channel.checked for channel in mapping.values())
