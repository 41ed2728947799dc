"""The largest force of a servo is a parameter: it cuts off what the controller asks for, and not the damping."""

import mujoco
import numpy as np
import pytest
import torch

from deepkoco.diagnose.causes import catalogue
from deepkoco.fit import fit
from deepkoco.systems import ExtendedSystem
from deepkoco.systems.motion import Motion
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.write_back import extended_mjcf
from tests.systems.trees.random_trees import mujoco_log

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


def test_strength_of_a_drive_scales_its_limit_too(arm):
    # A sagging supply lowers the largest force with the gains.
    system = ExtendedSystem(arm, ("drive_strength(j)",), {"drive_strength(j).factor": 0.5})
    weak = system.accelerations(system.default_parameters())(motion(3.0, 0.2, 0.7))
    own = arm.accelerations(with_limit(arm, 2.0))(motion(3.0, 0.2, 0.7))
    assert float(weak[0]) == pytest.approx(float(own[0]))


SERVO = """
<mujoco>
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody><body name="arm"><joint name="j" axis="0 1 0" damping="0.3" armature="0.01"/>
    <inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.01 0.01 0.01"/></body></worldbody>
  <actuator><position name="a" joint="j" kp="20" kv="0.5" forcerange="-{0} {0}"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize(("step", "reached"), [(0.6, True), (0.02, False)])
def test_fit_finds_the_limit_of_a_servo_that_saturates_and_leaves_that_of_another(tmp_path, step, reached):
    (tmp_path / "servo.xml").write_text(SERVO.format(4.0))
    system = TreeSystem.from_file(tmp_path / "servo.xml")
    rng = np.random.default_rng(0)
    goals = np.repeat(rng.uniform(-step, step, (20, 1)), 40, axis=0)
    model = mujoco.MjModel.from_xml_string(SERVO.format(2.0))
    log = mujoco_log(model, system, goals, 100.0, rng)
    found = fit([log], system, ["force_limit(a)", "damping(j)"]).estimates["force_limit(a)"]
    if reached:
        assert abs(found.value - 2.0) < 0.02
    else:
        assert found.value == pytest.approx(4.0)
        assert found.high - found.low > 4.0  # as wide as its prior


def test_cause_of_another_limit_is_searched_for_below_what_cuts_off(arm):
    starts = catalogue(arm)["changed(force_limit(a))"].starts(None)
    assert starts[0] == {}
    values = [start["force_limit(a)"] for start in starts[1:]]
    assert values == sorted(values, reverse=True)
    assert values[0] < 4.0
    assert values[-1] < 0.4
    assert catalogue(arm)["changed(kp(a))"].starts(None) == [{}]
