"""Causes at the bodies of a robot from MJCF: what a payload and an outside force free there."""

import mujoco
import numpy as np
import pytest

from deepkoco.diagnose.causes import catalogue
from deepkoco.systems import ExtendedSystem
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.compile_tree import compile_tree

ARM = """
<mujoco model="arm"><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
    <body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .2 0 0"/><site name="grip" pos=".2 0 0"/></body></body>
</worldbody></mujoco>
"""


@pytest.fixture(scope="module")
def arm() -> TreeSystem:
    return TreeSystem(compile_tree(mujoco.MjModel.from_xml_string(ARM), "arm"))


def test_a_payload_on_a_body_has_a_place_and_one_at_a_site_has_none(arm):
    causes = catalogue(arm)
    assert causes["payload"].free == ("payload.mass",)  # at the site of the gripper
    for body in ("upper", "fore"):
        cause = causes[f"payload({body})"]
        assert cause.free == (f"payload({body}).mass", f"payload({body}).along")
        assert "place" in cause.summary
        assert cause.size == 2
        declared = {p.name: p for p in ExtendedSystem(arm, (cause.effect,)).parameters}
        along = declared[f"payload({body}).along"]
        assert along.low < 0.0 < along.value < along.high


def test_an_outside_force_frees_the_components_that_load_a_joint(arm):
    cause = catalogue(arm)["force(fore)"]
    assert cause.free == ("force(fore).x", "force(fore).z")
    declared = {p.name: p for p in ExtendedSystem(arm, (cause.effect,)).parameters}
    # The reach of the arm times the force is a tenth of the load that the shoulder or the elbow typically has.
    reach = 0.1 * min(arm.load_scales[0] / 0.4, arm.load_scales[1] / 0.1)
    assert np.isclose(declared["force(fore).x"].prior_sd, reach, rtol=0.05)


def test_a_short_flange_may_carry_a_tool_of_the_size_of_the_robot():
    text = ARM.replace(
        '<site name="grip" pos=".2 0 0"/>',
        '<body name="flange" pos=".2 0 0"><joint name="roll" axis="0 0 1"/>'
        '<geom type="box" size=".03 .02 .01" pos=".005 0 0"/></body>',
    )
    arm = TreeSystem(compile_tree(mujoco.MjModel.from_xml_string(text), "arm"))
    declared = {p.name: p for p in ExtendedSystem(arm, ("payload",)).parameters}
    # The flange's own centre of mass is 5 mm off its axis; the way to it is 0.5 m.
    assert declared["payload.along"].high == pytest.approx(0.1)
    fore = {p.name: p for p in ExtendedSystem(arm, ("payload(fore)",)).parameters}
    assert fore["payload(fore).along"].high == pytest.approx(0.4)
