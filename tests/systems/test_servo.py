"""The position servo against MuJoCo's position actuator and a motor worked out by hand."""

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.systems import make_system
from deepkoco.systems.servo import Servo, servo_of, servo_parameters

ARM = """
<mujoco><worldbody><body><joint name="j" type="hinge" axis="0 1 0"/>
<geom type="capsule" size="0.01" fromto="0 0 0 0 0 -0.2" mass="0.3"/></body></worldbody>
<actuator><position joint="j" kp="20" kv="0.7" forcerange="-2.5 2.5" ctrlrange="-3 3"/></actuator></mujoco>
"""


def scalar(value):
    return torch.tensor(value, dtype=torch.float64)


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-20.0, 20.0))
def test_servo_gives_the_force_of_a_position_actuator_of_mujoco(goal, angle, speed):
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.ctrl[0], data.qpos[0], data.qvel[0] = goal, angle, speed
    mujoco.mj_forward(model, data)
    servo = Servo(20.0, 0.7, 2.5)
    torque = servo.torque(scalar(goal), scalar(angle), scalar(speed))
    assert float(torque) == pytest.approx(float(data.actuator_force[0]), abs=1e-9)


def test_servo_at_its_pwm_limit_is_a_motor_at_full_voltage():
    # A motor of 2 ohm and 0.05 N m/A behind a gear of 100 at 6 V: stall torque 0.05 * 6 / 2 * 100 = 15 N m,
    # back EMF torque 0.05^2 * 100^2 / 2 = 12.5 N m s/rad. At 0.4 rad/s of the arm: 15 - 5 = 10 N m.
    servo = Servo(stiffness=1000.0, limit=15.0, back_emf=12.5)
    assert float(servo.torque(scalar(1.0), scalar(0.0), scalar(0.4))) == pytest.approx(10.0)
    # With 3 V instead of 6 V: 7.5 - 5 = 2.5 N m.
    weak = servo._replace(supply=0.5)
    assert float(weak.torque(scalar(1.0), scalar(0.0), scalar(0.4))) == pytest.approx(2.5)
    # Switched off, the motor is open and its back EMF drives no current.
    assert float(servo.torque(scalar(1.0), scalar(0.0), scalar(0.4), scalar(0.0))) == 0.0


@given(st.floats(0.3, 2.0), st.floats(-1.0, 1.0))
def test_supply_that_scales_stiffness_limit_and_damping_acts_alike(supply, angle):
    low = Servo(20.0, 0.5, 3.0, 0.2, supply)
    scaled = Servo(20.0 * supply, 0.5 * supply, 3.0 * supply, 0.2)
    state = (scalar(0.4), scalar(angle), scalar(1.5))
    assert float(low.torque(*state)) == pytest.approx(float(scaled.torque(*state)))


def test_servo_parameters_declare_what_the_servo_reads():
    declared = servo_parameters(stiffness=10.0, limit=2.0, back_emf=0.1)
    servo = servo_of({p.name: scalar(p.value) for p in declared})
    assert float(servo.torque(scalar(0.1), scalar(0.0), scalar(0.0))) == pytest.approx(1.0)
    assert float(servo.torque(scalar(9.0), scalar(0.0), scalar(1.0))) == pytest.approx(2.0 - 0.1)


def test_servo_pendulum_has_the_torque_of_its_servo():
    system = make_system("servo_pendulum")
    p = system.default_parameters()
    state = torch.tensor([0.3, -2.0], dtype=torch.float64)
    effort = torch.tensor([1.1, 1.0], dtype=torch.float64)
    # k_p (q - theta) - k_d theta' - m g l sin(theta) - b theta'
    torque = 10.0 * 0.8 + 0.3 * 2.0 - 0.0574 * np.sin(0.3) + 0.03 * 2.0
    assert float(system.derivative(state, effort, p)[1]) == pytest.approx(torque / 0.011)
