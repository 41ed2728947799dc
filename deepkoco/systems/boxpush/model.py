"""The MJCF model of the arm, the table and the box."""

from __future__ import annotations

from deepkoco.systems.boxpush.arm import JOINTS, TOOL, TOOL_RADIUS

BOX_HALF = (0.05, 0.05, 0.04)
"""Half of the sides of the box [m]."""
BOX_MASS, FRICTION = 0.4, 0.4
"""Of the box [kg], and of it on the table."""
TOOL_FRICTION = 0.3
TIME_STEP = 0.005
"""Of the physics [s]."""
_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
_WIDTHS = (0.05, 0.035, 0.03, 0.028, 0.025, TOOL_RADIUS)  # of the links [m]


def box_push_model() -> str:
    """MJCF text: actuators with the names of the joints, a free joint `box`, geoms `table`, `box` and `tool`.

    Tool, box and table touch each other; the links of the arm touch nothing. Of two geoms the larger friction holds, so
    that of the table is 0 and ``friction(box)`` is the one between box and table; that of the tool has priority.
    """
    half = " ".join(f"{side!r}" for side in BOX_HALF)
    return f"""
<mujoco model="box_push">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{TIME_STEP!r}" integrator="implicitfast" iterations="20" ls_iterations="20"/>
  <default>
    <geom contype="0" conaffinity="0"/>
    <joint damping="0.2" armature="0.02"/>
  </default>
  <worldbody>
    <light pos="0.4 -0.6 1.5" dir="0 0.4 -1"/>
    <geom name="table" type="plane" size="2 2 0.1" contype="1" conaffinity="0" friction="0 0.0001 0.00001"
          rgba="0.82 0.84 0.86 1"/>
    <body name="box" pos="0.4 0 {BOX_HALF[2]!r}">
      <freejoint name="box"/>
      <geom name="box" type="box" size="{half}" mass="{BOX_MASS!r}" contype="2" conaffinity="1"
            friction="{FRICTION!r} 0.0001 0.00001" rgba="0.30 0.55 0.75 1"/>
    </body>
{_link(0, "    ")}
  </worldbody>
  <actuator>
{_actuators()}
  </actuator>
</mujoco>
"""


def _link(index: int, indent: str) -> str:
    """The body behind a hinge, with all that it carries."""
    joint = JOINTS[index]
    offset = " ".join(f"{length!r}" for length in joint.offset)
    last = index == len(JOINTS) - 1
    end = (TOOL - TOOL_RADIUS, 0.0, 0.0) if last else JOINTS[index + 1].offset
    span = f"0 0 0 {end[0]!r} {end[1]!r} {end[2]!r}"
    touches = 'name="tool" contype="1" conaffinity="3" priority="1" ' if last else ""
    friction = f'friction="{TOOL_FRICTION!r} 0.0001 0.00001" ' if last else ""
    inner = "" if last else _link(index + 1, indent + "  ") + "\n"
    return f"""{indent}<body name="{joint.name}" pos="{offset}">
{indent}  <joint name="{joint.name}" axis="{_AXES[joint.axis]}" range="{joint.low!r} {joint.high!r}"/>
{indent}  <geom {touches}{friction}type="capsule" fromto="{span}" size="{_WIDTHS[index]!r}" mass="{joint.mass!r}"
{indent}        rgba="0.25 0.27 0.30 1"/>
{inner}{indent}</body>"""


def _actuators() -> str:
    return "\n".join(
        f'    <position name="{j.name}" joint="{j.name}" kp="{j.gain!r}" kv="{j.damping!r}" '
        f'ctrlrange="{j.low!r} {j.high!r}" forcerange="{-j.torque!r} {j.torque!r}"/>'
        for j in JOINTS
    )
