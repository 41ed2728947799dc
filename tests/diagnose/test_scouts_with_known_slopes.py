"""Candidates whose fits with the slopes of their reference end far above their own minimum."""

import mujoco
import numpy as np
import pandas as pd
import pytest

from deepkoco import load_system
from deepkoco.diagnose import diagnose
from deepkoco.logs import read_log

pytestmark = [pytest.mark.study, pytest.mark.long]

PAN_TILT = """<mujoco><option timestep="0.0001" integrator="implicitfast"/><compiler angle="radian"/>
<worldbody><body name="base" pos="0 0 0.1"><joint name="pan" axis="0 0 1" damping="0.02" armature="0.002"/>
<inertial pos="0.01 0 0.03" mass="0.45" diaginertia="0.0006 0.0006 0.0005"/>
<body name="camera" pos="0 0 0.08"><joint name="tilt" axis="0 1 0" damping="0.015" armature="0.002"/>
<inertial pos="0.035 0 0.01" mass="0.6" diaginertia="0.0008 0.0012 0.0010"/></body></body></worldbody>
<actuator><velocity name="pan_rate" joint="pan" kv="0.6" ctrlrange="-4 4"/>
<velocity name="tilt_rate" joint="tilt" kv="0.8" ctrlrange="-4 4"/></actuator></mujoco>"""


def test_a_stiffer_bearing_is_in_the_class_of_the_weaker_servo_that_moves_alike(tmp_path):
    # kv (u - speed) - d speed: far below its corner frequency a servo of a larger d is one of a smaller gain.
    model = mujoco.MjModel.from_xml_string(PAN_TILT)
    rng, data, rows, goal = np.random.default_rng(39723), mujoco.MjData(model), [], np.zeros(2)
    model.body_mass[1:] *= 1.0 + 0.01 * rng.standard_normal(2)
    model.dof_damping[:] *= 1.0 + 0.05 * rng.standard_normal(2)
    model.dof_damping[1] *= 6.0
    for k in range(2500):
        if k % int(rng.integers(15, 60)) == 0:
            goal = rng.uniform(-3.0, 3.0, 2)
        if abs(data.qpos[1]) > 0.9:
            goal[1] = -2.0 * np.sign(data.qpos[1])
        shown = np.degrees(data.qpos) + 0.02 * rng.standard_normal(2)
        rows.append((0.01 * k, *np.round(goal, 4), *np.radians(np.round(shown, 3))))
        data.ctrl[:] = goal
        mujoco.mj_step(model, data, 100)
    (tmp_path / "robot.xml").write_text(PAN_TILT)
    pd.DataFrame(rows, columns=["t", "u1", "u2", "q1", "q2"]).to_csv(tmp_path / "log.csv", index=False)
    channels = {
        "pan_rate": {"column": "u1", "unit": "rad/s", "kind": "command"},
        "tilt_rate": {"column": "u2", "unit": "rad/s", "kind": "command"},
        "q_pan": {"column": "q1", "unit": "rad", "kind": "measurement"},
        "q_tilt": {"column": "q2", "unit": "rad", "kind": "measurement"},
    }
    log = read_log(tmp_path / "log.csv", {"time": {"column": "t", "unit": "s"}, "channels": channels})
    result = diagnose([log], load_system(str(tmp_path / "robot.xml")), only=["viscous(tilt)", "gain(tilt)"])
    assert result.verdict in ("cause", "ambiguous")
    assert set(result.causes[0].members) == {"viscous(tilt)", "gain(tilt)"}
    by_name = {c.name: c.parameters for c in result.candidates}
    assert by_name["viscous(tilt)"]["viscous(tilt).change"].value == pytest.approx(0.075, rel=0.1)
