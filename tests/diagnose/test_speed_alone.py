"""A joint of which a log shows the speed alone: its report has no picture of positions."""

import mujoco
import numpy as np
import pandas as pd
import pytest

from deepkoco.cli.command_line import main

CONVEYOR = """
<mujoco model="conveyor"><option integrator="RK4"/><worldbody><body><joint name="roller" axis="0 1 0" damping="0.02"/>
  <geom type="cylinder" size="0.05 0.2" mass="2" quat="0.707 0.707 0 0"/></body></worldbody>
<actuator><velocity name="speed_servo" joint="roller" kv="0.3"/></actuator></mujoco>
"""


@pytest.mark.study
def test_a_log_of_a_tachometer_ends_in_a_report(tmp_path):
    (tmp_path / "robot.xml").write_text(CONVEYOR)
    model = mujoco.MjModel.from_xml_string(CONVEYOR)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    t = np.arange(0.0, 12.0, 0.01)
    goal = np.repeat(rng.uniform(-20.0, 20.0, 24), 50)
    speed = []
    for u in goal:
        speed.append(float(data.qvel[0]))
        for _ in range(5):
            data.ctrl[:] = u
            mujoco.mj_step(model, data)
    noisy = np.array(speed) + 0.05 * rng.standard_normal(len(t))
    frame = {"time_s": t, "roller_speed [rpm]": noisy * 60.0 / (2.0 * np.pi), "speed_servo": goal}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    log, robot, sidecar = (str(tmp_path / name) for name in ("log.csv", "robot.xml", "log.yaml"))
    assert main(["inspect", log, "--system", robot, "--out", sidecar]) == 0
    assert main(["diagnose", log, "--system", robot, "--out", str(tmp_path / "out")]) in (0, 1)
    assert (tmp_path / "out" / "report.html").is_file()
