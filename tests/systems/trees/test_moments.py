"""Moments of inertia that a motion shows: no kink where a body would be flat, and a physical body in the file."""

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.systems import ExtendedSystem, Motion
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.parameters import moments_beside
from deepkoco.systems.trees.robot_files import write_robot

LINK = """<mujoco model="link"><worldbody><body name="link">
  <joint name="hinge" type="hinge" axis="0 1 0" damping="0.05" armature="0.01"/>
  <inertial pos="0.15 0 0" mass="0.8" diaginertia="{moments}"/></body></worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-2 2"/></actuator></mujoco>"""
ROD, LAMINA = "0.0002 0.006 0.006", "0.002 0.006 0.008"


def robot_of(folder, moments):
    file = folder / "link.xml"
    file.write_text(LINK.format(moments=moments))
    return TreeSystem.from_file(file)


@pytest.mark.parametrize("moments", [ROD, LAMINA])
def test_the_motion_of_a_rod_is_smooth_in_its_moment(tmp_path, moments):
    system = robot_of(tmp_path, moments)
    assert [n for n in system.default_parameters() if n.startswith("inertia")] == ["inertia_y(link)"]
    # Far below the moment at which the others of the file would make a flat body.
    moment = torch.linspace(0.003, 0.009, 61, dtype=torch.float64)
    values = {**system.default_parameters(), "inertia_y(link)": moment}
    still = Motion(*((torch.zeros(61, dtype=torch.float64) + x,) for x in (0.3, 0.0, 1.0)))
    (found,) = system.accelerations(values)(still)
    inertia = moment + 0.8 * 0.15**2 + 0.01
    torch.testing.assert_close(found * inertia, found[0] * inertia[0].expand(61), rtol=1e-12, atol=0.0)


def test_a_written_rod_has_the_moment_that_was_fitted(tmp_path):
    system = ExtendedSystem(robot_of(tmp_path, ROD), (), {"inertia_y(link)": 0.004})
    write_robot(system, tmp_path, tmp_path)
    (file,) = (f for f in tmp_path.glob("*.xml") if f.name != "link.xml")
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    whole = np.zeros(1)
    mujoco.mj_mulM(model, data, whole, np.ones(1))
    assert whole[0] == pytest.approx(0.004 + 0.8 * 0.15**2 + 0.01, rel=1e-9)


@given(
    st.lists(st.floats(1e-6, 1.0), min_size=3, max_size=3), st.lists(st.booleans(), min_size=3, max_size=3)
)
def test_moments_are_those_of_a_body_and_those_that_are_shown_stay(moments, shown):
    found = moments_beside(moments, shown)
    assert max(found) <= (sum(found) - max(found)) * (1.0 + 1e-12)
    if not all(shown):
        assert all(a == b for a, b, known in zip(moments, found, shown, strict=True) if known)
