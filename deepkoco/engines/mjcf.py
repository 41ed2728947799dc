"""The MuJoCo model of a body on one hinge."""

from __future__ import annotations

from typing import NamedTuple

from deepkoco.systems import Channel


class HingedBody(NamedTuple):
    """A rigid body on a hinge, up at angle 0.

    Attributes:
        mass: [kg].
        reach: From the hinge to the centre of mass [m]; negative: it hangs at angle 0.
        inertia: About the centre of mass [kg m2].
        damping: Linear friction of the hinge, back-EMF included [N m s/rad].
        gear: Torque per unit of the command [N m].
        gravity: [m/s2].
        friction: Dry friction of the hinge [N m].
    """

    mass: float
    reach: float
    inertia: float
    damping: float
    gear: float
    gravity: float
    friction: float = 0.0


def model_xml(
    name: str, body: HingedBody, command: Channel, sensors: tuple[Channel, ...], time_step: float
) -> str:
    """Describe the body in MJCF, its actuator and sensors under the names of their channels.

    Args:
        name: Name of the model.
        body: The body.
        command: Channel of the actuator.
        sensors: Channels of joint angle and speed.
        time_step: Step of the physics [s].
    """
    angle, speed = sensors
    # Constraints cost time. Those of dry friction are soft; these numbers make them nearly rigid.
    rubs = body.friction > 0.0
    friction = f'frictionloss="{body.friction!r}" solreffriction="{2.0 * time_step!r} 1"' if rubs else ""
    constraint = "enable" if rubs else "disable"
    # Without the flag MuJoCo puts a body whose state is no number back to zero and goes on.
    tip, width = 2.0 * body.reach, 0.1 * abs(body.reach)
    return f"""
<mujoco model="{name}">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{time_step!r}" integrator="RK4" gravity="0 0 {-body.gravity!r}">
    <flag contact="disable" constraint="{constraint}" autoreset="disable"/>
  </option>
  <worldbody>
    <light pos="0 -2 2" dir="0 1 -1"/>
    <body name="{name}">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="{body.damping!r}" {friction}
             solimpfriction="0.9999 0.9999 0.001"/>
      <inertial pos="0 0 {body.reach!r}" mass="{body.mass!r}"
                diaginertia="{body.inertia!r} {body.inertia!r} {body.inertia!r}"/>
      <geom type="capsule" fromto="0 0 0 0 0 {tip!r}" size="{width!r}" rgba="0.8 0.3 0.3 1"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="{command.name}" joint="hinge" gear="{body.gear!r}"/>
  </actuator>
  <sensor>
    <jointpos name="{angle.name}" joint="hinge"/>
    <jointvel name="{speed.name}" joint="hinge"/>
  </sensor>
</mujoco>
"""
