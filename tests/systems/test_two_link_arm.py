"""The arm against MuJoCo, the balance of energy, and the formulas of its picture."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems import JointCountError, TwoLinkArm, make_system, one_joint, rk4_step

ANGLE, SPEED, TORQUE = st.floats(-4.0, 4.0), st.floats(-5.0, 5.0), st.floats(-2.0, 2.0)


def vector(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def mujoco_path(arm: TwoLinkArm, start: list[float], torques: np.ndarray, steps: int) -> np.ndarray:
    """States (steps, 4) of MuJoCo's own model of two uniform rods at 1 kHz, torques (steps, 2)."""
    mujoco = pytest.importorskip("mujoco")
    p = {parameter.name: parameter.value for parameter in arm.parameters}

    def rod(i: int) -> str:
        mass, length = p[f"mass_{i}"], p[f"length_{i}"]
        about = mass * length**2 / 12.0
        return f"""<joint name="j{i}" axis="0 0 1" damping="{p[f"viscous_{i}"]}"/>
        <inertial pos="{length / 2} 0 0" mass="{mass}" diaginertia="1e-9 {about} {about}"/>"""

    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><compiler angle="radian" balanceinertia="true"/>
      <option timestep="0.001" integrator="RK4" gravity="0 0 0"/>
      <worldbody><body>{rod(1)}<body pos="{p["length_1"]} 0 0">{rod(2)}</body></body></worldbody>
      <actuator><motor joint="j1"/><motor joint="j2"/></actuator>
    </mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start[:2], start[2:]
    states = []
    for k in range(steps):
        data.ctrl[:] = torques[k]
        mujoco.mj_step(model, data)
        states.append([*data.qpos, *data.qvel])
    return np.array(states)


def test_it_moves_as_mujocos_model_of_two_rods():
    arm = TwoLinkArm()
    torques = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, (6, 2)) * [6.0, 3.0], 100, 0)
    start = [0.4, -2.0, 1.0, -3.0]
    expected = mujoco_path(arm, start, torques, len(torques))
    state, parameters = vector(*start), arm.default_parameters()
    for k, torque in enumerate(torques):
        state = rk4_step(arm, state, torch.as_tensor(torque), 0.001, parameters)
        if k % 200 == 199:
            np.testing.assert_allclose(state.numpy(), expected[k], atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    bend=ANGLE, speeds=st.tuples(SPEED, SPEED), torques=st.tuples(TORQUE, TORQUE), payload=st.floats(0.0, 2.0)
)
def test_energy_changes_by_what_torques_and_friction_do(bend, speeds, torques, payload):
    """dE/dt = tau . q' - q' D q', by the gradient of the energy along the motion."""
    arm = TwoLinkArm()
    parameters = arm.with_payload(torch.tensor(payload), arm.default_parameters())
    state = vector(0.3, bend, *speeds).requires_grad_()
    (gradient,) = torch.autograd.grad(arm.kinetic_energy(state, parameters), state)
    rate = float(gradient @ arm.derivative(state.detach(), vector(*torques), parameters))
    power = sum(u * w for u, w in zip(torques, speeds, strict=True))
    losses = 1.5 * speeds[0] ** 2 + 0.75 * speeds[1] ** 2
    assert rate == pytest.approx(power - losses, abs=1e-9)


def test_kinetic_energy_is_that_of_the_rods():
    """Each rod: m |v|^2 / 2 of its middle, plus its turning; v by finite differences of the middles' places."""
    arm = TwoLinkArm()
    state = vector(0.7, -1.2, 1.5, -2.5)

    def middles(first: float, second: float) -> np.ndarray:
        elbow = 0.5 * np.array([np.cos(first), np.sin(first)])
        return np.array(
            [elbow / 2, elbow + 0.25 * np.array([np.cos(first + second), np.sin(first + second)])]
        )

    h = 1e-6
    velocity = (middles(0.7 + 1.5 * h, -1.2 - 2.5 * h) - middles(0.7 - 1.5 * h, -1.2 + 2.5 * h)) / (2 * h)
    turning = 0.5 * 3.0 / 12 * 0.25 * (1.5**2 + (1.5 - 2.5) ** 2)
    energy = 0.5 * 3.0 * (velocity**2).sum() + turning
    assert float(arm.kinetic_energy(state, arm.default_parameters())) == pytest.approx(energy, rel=1e-6)


def test_a_batch_of_parameters_equals_one_by_one():
    arm = TwoLinkArm()
    states = torch.tensor([[0.1, 0.5, 1.0, -1.0], [2.0, -1.0, 0.3, 0.7]], dtype=torch.float64)
    efforts = torch.tensor([[1.0, -0.5], [0.2, 0.9]], dtype=torch.float64)
    nominal = arm.default_parameters()
    batch = {**nominal, "mass_2": vector(0.5, 2.0)}
    together = arm.derivative(states, efforts, batch)
    for i, mass in enumerate((0.5, 2.0)):
        alone = arm.derivative(states[i], efforts[i], {**nominal, "mass_2": vector(mass)[0]})
        assert torch.equal(together[i], alone)


def test_the_tip_of_the_bent_arm_is_where_trigonometry_says():
    arm = TwoLinkArm()
    tip = arm.tip(vector(np.pi / 2, -np.pi / 2), arm.default_parameters())
    np.testing.assert_allclose(tip, [0.5, 0.5], atol=1e-12)


def test_the_picture_shows_the_tip_where_it_is():
    arm = TwoLinkArm()
    up = arm.draw(np.array([np.pi / 2, 0.0, 0.0, 0.0]), np.zeros(2), 64)
    right = arm.draw(np.zeros(4), np.zeros(2), 64)
    background = up[0, 0].astype(int)
    assert (np.abs(up[:24] - background) > 30).any()
    assert not (np.abs(up[40:] - background) > 30).any()
    assert (np.abs(right[:, 40:] - background) > 30).any()
    assert not (np.abs(right[:24] - background) > 30).any()
    assert not np.array_equal(right, arm.draw(np.zeros(4), np.array([1.0, 0.0]), 64))


@pytest.mark.parametrize("system", ["two_link_arm", make_system("two_link_arm")])
def test_what_takes_one_joint_refuses_it_with_a_clear_error(system):
    with pytest.raises(
        JointCountError, match=r"two_link_arm has 2 joints; .* choose one of pendulum, rod_pendulum"
    ):
        one_joint(system)
