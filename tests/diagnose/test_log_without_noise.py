"""A log without any noise, from a simulator with another integrator."""

import mujoco
import numpy as np
import pandas as pd
import pytest

from deepkoco import load_system
from deepkoco.diagnose import diagnose
from deepkoco.logs import read_log

pytestmark = pytest.mark.study

PENDULUM = """<mujoco><option timestep="0.0001" integrator="implicitfast"/><worldbody><body pos="0 0 1">
<joint name="j" axis="0 1 0" damping="0.05"/><geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.8"/>
</body></worldbody><actuator><motor name="m" joint="j" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.mark.parametrize(("friction", "verdict"), [(0.0, "nothing"), (0.05, "cause")])
def test_the_integrator_of_a_simulated_log_is_no_fault(tmp_path, friction, verdict):
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    model.dof_frictionloss[0], model.dof_solref[:] = friction, (4e-4, 1.0)
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(3), []
    for k in range(2000):
        if k % 40 == 0:
            data.ctrl[0] = rng.uniform(-1.0, 1.0)
        rows.append((k * 0.01, data.ctrl[0], data.qpos[0]))
        mujoco.mj_step(model, data, 100)
    (tmp_path / "robot.xml").write_text(PENDULUM)
    pd.DataFrame(rows, columns=["t", "u", "q"]).to_csv(tmp_path / "log.csv", index=False)
    log = read_log(
        tmp_path / "log.csv",
        {
            "time": {"column": "t", "unit": "s"},
            "channels": {
                "m": {"column": "u", "unit": "N m", "kind": "command"},
                "q_j": {"column": "q", "unit": "rad", "kind": "measurement"},
            },
        },
    )
    result = diagnose([log], load_system(str(tmp_path / "robot.xml")))
    assert result.verdict == verdict
    if friction:
        assert result.causes[0].name == "coulomb"
        assert result.causes[0].parameters["coulomb.torque"].value == pytest.approx(friction, rel=0.05)
