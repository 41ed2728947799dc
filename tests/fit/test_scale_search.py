"""Coarse search of sizes: a servo arm that is much too stiff, against a unit that MuJoCo simulates."""

import mujoco
import numpy as np
import pytest
import torch

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.tempered import sizes_of_joints
from deepkoco.fit import FitProblem, cut_windows
from deepkoco.fit.solve.scale_search import _costs, search_scales
from deepkoco.systems.trees import TreeSystem
from tests.systems.trees.random_trees import mujoco_log

ARM = """
<mujoco model="stiff_arm">
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.5" armature="0.03"/>
      <inertial pos="0 0 -0.1" mass="0.2" diaginertia="0.001 0.001 0.0002"/>
      <body name="fore" pos="0 0 -0.2">
        <joint name="elbow" axis="0 1 0" damping="0.5" armature="0.03"/>
        <inertial pos="0 0 -0.08" mass="0.1" diaginertia="0.0004 0.0004 0.0001"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="m_shoulder" joint="shoulder" kp="{shoulder}" kv="{kv}" forcerange="-4 4"/>
    <position name="m_elbow" joint="elbow" kp="{elbow}" kv="{kv}" forcerange="-4 4"/>
  </actuator>
</mujoco>
"""
STIFF = {"shoulder": 900, "elbow": 900, "kv": 2}
SOFT = {"shoulder": 20, "elbow": 60, "kv": 2}


@pytest.fixture(scope="module")
def stiff(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(ARM.format(**STIFF))
    system = TreeSystem.from_file(path)
    rng = np.random.default_rng(20000)
    goals = np.repeat(rng.uniform(-0.8, 0.8, (24, 2)), 12, axis=0)
    logs = [
        mujoco_log(mujoco.MjModel.from_xml_string(ARM.format(**own)), system, goals, 50.0, rng)
        for own in (SOFT, STIFF)
    ]
    return system, *(cut_windows([log], system, 1.0) for log in logs)


def searched(system, windows):
    start = baseline_from(system, windows)
    problem = FitProblem(start.system, windows)
    state, _ = problem.fit_states(start.values, windows.state)
    return search_scales(problem, sizes_of_joints(start), start.values, state)


def test_search_scales_finds_each_servos_stiffness_within_a_factor_of_three(stiff):
    system, soft, _ = stiff
    values, left = searched(system, soft)
    assert 20.0 / 3.0 < values["kp(m_shoulder)"] < 60.0
    assert 20.0 < values["kp(m_elbow)"] < 180.0
    assert left < 0.1


def test_cost_is_the_same_however_bad_one_window_is(stiff):
    system, soft, _ = stiff
    start = baseline_from(system, soft)
    costs = []
    for push in (30.0, 300.0):
        value = soft.value.clone()
        value[3] += torch.linspace(0.0, push, value.shape[-1], dtype=value.dtype)
        problem = FitProblem(start.system, soft.with_value(value))
        given = np.array([[float(start.values[n]) for n in problem.names]])
        costs.append(_costs(problem, given, soft.state))
    np.testing.assert_allclose(costs[0], costs[1], rtol=1e-12)
    assert costs[0].sum() > 0.0


def test_search_scales_leaves_values_that_are_right(stiff):
    system, _, same = stiff
    values, left = searched(system, same)
    assert left > 0.5
    assert values["kp(m_shoulder)"] > 300.0


def test_sizes_of_joints_are_what_no_drawing_tells(stiff):
    system, soft, _ = stiff
    own = ("damping({0})", "kp(m_{0})", "kv(m_{0})", "force_limit(m_{0})")
    assert sizes_of_joints(baseline_from(system, soft)) == {
        j: {name.partition("(")[0]: name.format(joint) for name in own}
        for j, joint in enumerate(("shoulder", "elbow"))
    }
