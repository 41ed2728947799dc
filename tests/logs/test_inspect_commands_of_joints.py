"""Commands that are called after the joints that they drive, behind a screw or a gear; and drives that a log lacks."""

import numpy as np
import pandas as pd

import deepkoco
from deepkoco.cli.command_line import main
from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import propose, survey_log
from deepkoco.logs.inspect.partial import OPEN

BOOM = """<mujoco><worldbody>
<body><joint name="luff" type="hinge" axis="0 -1 0"/><inertial pos="0.4 0 0" mass="9" diaginertia="0.1 0.9 0.9"/>
<body pos="0.6 0 0"><joint name="reach" type="slide" axis="1 0 0"/>
<inertial pos="0.2 0 0" mass="5" diaginertia="0.1 0.2 0.2"/></body></body></worldbody>
<actuator><motor name="luff_drive" joint="luff" gear="80"/>
<motor name="reach_drive" joint="reach" gear="300"/></actuator>
</mujoco>"""
T = np.arange(0.0, 8.0, 0.01)
FAST, SLOW = np.sin(2.0 * T) + np.sin(3.7 * T), np.cos(0.9 * T) + np.sin(1.3 * T)


def written(tmp_path, commands):
    (tmp_path / "boom.xml").write_text(BOOM)
    frame = {"time": T, "boom_deg": 20.0 * SLOW, "tele_mm": 100.0 * FAST, **commands}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv", tmp_path / "boom.xml"


def test_a_torque_of_a_motor_is_no_goal_of_a_joint_and_goes_to_the_drive_of_the_joint_in_its_name(tmp_path):
    log, robot = written(tmp_path, {"luff_cmd_Nm": FAST, "reach_cmd_Nm": SLOW})
    choices = propose(survey_log(open_log(log)), deepkoco.load_system(robot)).proposal.choices
    found = {c.channel.name: c.column.name for c in choices if c.column is not None}
    assert found["luff_drive"] == "luff_cmd_Nm"
    assert found["reach_drive"] == "reach_cmd_Nm"


def test_a_sidecar_asks_for_the_command_of_a_joint_that_the_log_shows(tmp_path):
    # Every command refuses a sidecar without it.
    log, robot = written(tmp_path, {"luff_cmd_Nm": FAST})
    out = tmp_path / "map.yaml"
    assert main(["inspect", str(log), "--system", str(robot), "--out", str(out)]) == 2
    sidecar = out.read_text()
    assert "reach_drive:\n" in sidecar
    assert OPEN in sidecar
    assert "luff_cmd_Nm" in sidecar
