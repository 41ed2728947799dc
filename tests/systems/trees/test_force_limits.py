"""The largest force of a servo is a parameter: it cuts off what the controller asks for, and not the damping."""

import mujoco
import numpy as np
import pytest
import torch

from deepkoco.systems import ExtendedSystem
from deepkoco.systems.motion import Motion
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.write_back import extended_mjcf

ARM = """
<mujoco>
  <worldbody>
    <body name="arm"><joint name="j" axis="0 1 0" damping="0.5"/>
      <inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.01"/>
      <body name="fore" pos="0 0 -0.3"><joint name="k" axis="0 1 0"/>
        <inertial pos="0 0 -0.1" mass="0.3" diaginertia="0.001 0.001 0.001"/></body>
    </body>
  </worldbody>
  <actuator>
    <position name="a" joint="j" kp="20" kv="1" forcerange="-2 4" gear="2"/>
    <motor name="b" joint="k" forcerange="-1 1"/>
  </actuator>
</mujoco>
"""


@pytest.fixture
def arm(tmp_path) -> TreeSystem:
    (tmp_path / "arm.xml").write_text(ARM)
    return TreeSystem.from_file(tmp_path / "arm.xml")


def motion(goal, angle, speed, effort=0.0):
    values = [torch.tensor([x], dtype=torch.float64) for x in (angle, 0.1, speed, -0.4, goal, effort)]
    return Motion(tuple(values[:2]), tuple(values[2:4]), tuple(values[4:]))


def with_limit(arm, limit):
    return {**arm.default_parameters(), "force_limit(a)": torch.tensor([limit], dtype=torch.float64)}


def test_only_drives_with_a_loop_of_their_own_have_a_limit_to_fit(arm):
    limits = [p for p in arm.parameters if p.name.startswith("force_limit")]
    assert [(p.name, p.value, p.unit, p.guessed) for p in limits] == [("force_limit(a)", 4.0, "N m", True)]
    assert limits[0].low > 0.0


@pytest.mark.parametrize(("goal", "limit"), [(3.0, 4.0), (3.0, 1.5), (-3.0, 1.5), (0.41, 1.5)])
def test_accelerations_are_those_of_mujoco_with_this_force_range(arm, goal, limit):
    text = ARM.replace("-2 4", f"{-0.5 * limit} {limit}")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = (0.2, 0.1), (0.7, -0.4), (goal, 0.3)
    mujoco.mj_forward(model, data)
    ours = arm.accelerations(with_limit(arm, limit))(motion(goal, 0.2, 0.7, 0.3))
    np.testing.assert_allclose([float(a) for a in ours], data.qacc, rtol=1e-9)


def test_loop_and_torch_agree_and_the_limit_has_a_slope_only_where_it_cuts(arm):
    for goal, cut in ((3.0, True), (0.45, False)):
        own = with_limit(arm, 1.5)
        plain = arm.accelerations(own)(motion(goal, 0.2, 0.7))
        own["force_limit(a)"].requires_grad_()
        traced = arm.accelerations(own)(motion(goal, 0.2, 0.7))
        assert float(traced[0].detach()) == pytest.approx(float(plain[0]), rel=1e-12)
        slope = torch.autograd.grad(traced[0].sum(), own["force_limit(a)"])[0]
        assert (float(slope) != 0.0) == cut


def test_damping_of_the_joint_acts_beyond_the_limit_and_the_rate_gain_within(arm):
    # At the limit of 4 N m the joint gets 2 * 4 = 8 N m, whatever kv is; 1 N m s/rad more of damping takes away as
    # much as a load of -0.7 N m at 0.7 rad/s.
    given = arm.accelerations(with_limit(arm, 4.0))
    faster = motion(3.0, 0.2, 0.7)
    own = with_limit(arm, 4.0)
    rate = arm.accelerations({**own, "kv(a)": 2.0 * own["kv(a)"]})(faster)
    damped = arm.accelerations({**own, "damping(j)": own["damping(j)"] + 1.0})(faster)
    loads = (torch.tensor([-0.7], dtype=torch.float64), None)
    loaded = given(faster._replace(loads=loads))
    assert float(rate[0]) == pytest.approx(float(given(faster)[0]))
    assert float(damped[0]) == pytest.approx(float(loaded[0]))


def test_written_file_has_the_new_range(arm):
    system = ExtendedSystem(arm, (), {"force_limit(a)": 1.0})
    written = extended_mjcf(system)
    model = mujoco.MjModel.from_xml_string(written.xml)
    np.testing.assert_allclose(model.actuator_forcerange, [[-0.5, 1.0], [-1.0, 1.0]])
    changed = {c.attribute: (c.before, c.after) for c in written.changes}
    assert changed == {"forcerange low": (-2.0, -0.5), "forcerange high": (4.0, 1.0)}
