"""Fits of compiled trees to logs that MuJoCo itself simulated."""

import mujoco
import numpy as np

from deepkoco.fit import fit
from deepkoco.systems.trees import TreeSystem
from tests.systems.trees.random_trees import mujoco_log

ARM = """
<mujoco model="arm">
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="{shoulder}"/>
      <inertial pos="0 0 -0.15" mass="{upper}" diaginertia="0.01 0.01 0.001"/>
      <body name="fore" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" damping="0.05" armature="0.002"/>
        <inertial pos="0 0 -0.12" mass="{fore}" diaginertia="0.004 0.004 0.0005"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m_shoulder" joint="shoulder" ctrlrange="-6 6"/>
    <motor name="m_elbow" joint="elbow" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""
GIVEN = {"shoulder": 0.1, "upper": 1.0, "fore": 0.6}
TRUE = {"shoulder": 0.16, "upper": 1.0, "fore": 0.75}


def test_fit_finds_mass_and_damping_of_an_arm_simulated_by_mujoco(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(**GIVEN))
    system = TreeSystem.from_file(path)
    rng = np.random.default_rng(0)
    held = np.repeat(rng.uniform(-1.0, 1.0, (40, 2)), 20, axis=0) * [3.0, 1.0]
    model = mujoco.MjModel.from_xml_string(ARM.format(**TRUE))
    log = mujoco_log(model, system, held, 100.0, rng)
    found = fit([log], system, ["mass(fore)", "damping(shoulder)"])
    mass, damping = (found.estimates[name] for name in ("mass(fore)", "damping(shoulder)"))
    assert abs(mass.value - TRUE["fore"]) < 0.005 * TRUE["fore"]
    assert abs(damping.value - TRUE["shoulder"]) < 0.02 * TRUE["shoulder"]
