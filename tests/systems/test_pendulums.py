"""Equations of motion against closed forms and independent implementations."""

import math

import gymnasium
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from deepkoco.systems import JOINT_SYSTEMS, ParameterError, UnknownSystemError, make_system, rk4_step


def state_of(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_rod_pendulum_acceleration_is_gymnasiums():
    """One Gymnasium step divided by its period gives the acceleration at the old state."""
    reference = gymnasium.make("Pendulum-v1").unwrapped
    reference.reset(seed=0)
    reference.state = np.array([0.7, -0.3])
    reference.step(np.array([1.1]))
    expected = (reference.state[1] + 0.3) / reference.dt
    system = make_system("rod_pendulum")
    slope = system.derivative(state_of(0.7, -0.3), torch.tensor(1.1), system.default_parameters())
    assert slope[0] == -0.3
    assert float(slope[1]) == pytest.approx(expected, abs=1e-6)


def test_disk_pendulum_terms_worked_by_hand():
    """At theta = pi/2, omega = 0: J theta'' = u K/R + m g l."""
    system = make_system("pendulum")
    p = {name: float(value) for name, value in system.default_parameters().items()}
    slope = system.derivative(state_of(math.pi / 2, 0.0), torch.tensor(2.0), system.default_parameters())
    motor = 2.0 * p["motor_constant"] / p["resistance"]
    gravity = p["mass"] * 9.81 * p["length"]
    assert float(slope[1]) == pytest.approx((motor + gravity) / p["inertia"], rel=1e-12)


def test_torque_pendulum_hangs_at_zero():
    system = make_system("torque_pendulum")
    rest = system.derivative(state_of(0.0, 0.0), torch.tensor(0.0), system.default_parameters())
    assert rest.abs().max() == 0.0


@pytest.mark.parametrize("name", sorted(JOINT_SYSTEMS))
def test_rk4_agrees_with_scipy(name: str):
    system = make_system(name)
    parameters = system.default_parameters()
    effort = torch.tensor(0.4, dtype=torch.float64)
    state = state_of(1.0, 0.5)
    for _ in range(500):
        state = rk4_step(system, state, effort, 0.001, parameters)

    def slope(_: float, x: np.ndarray) -> np.ndarray:
        return system.derivative(torch.as_tensor(x), effort, parameters).numpy()

    exact = solve_ivp(slope, (0.0, 0.5), [1.0, 0.5], rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(state.numpy(), exact, atol=1e-6, rtol=1e-6)


@settings(max_examples=30, deadline=None)
@given(
    theta=st.floats(-10, 10),
    omega=st.floats(-8, 8),
    effort=st.floats(-2, 2),
    name=st.sampled_from(sorted(JOINT_SYSTEMS)),
)
def test_a_batch_of_parameters_equals_one_by_one(theta, omega, effort, name):
    system = make_system(name)
    states = state_of(theta, omega).expand(2, 2)
    efforts = torch.full((2,), effort, dtype=torch.float64)
    nominal = system.default_parameters()
    first = system.parameters[0]
    batch = {**nominal, first.name: torch.tensor([first.value, 1.1 * first.value], dtype=torch.float64)}
    together = system.derivative(states, efforts, batch)
    for i in range(2):
        alone = system.derivative(states[i], efforts[i], {**nominal, first.name: batch[first.name][i]})
        assert torch.equal(together[i], alone)


@pytest.mark.parametrize("name", sorted(JOINT_SYSTEMS))
def test_payload_adds_weight_and_inertia(name: str):
    """At the horizontal the weight of m_p at distance l adds m_p g l to the torque."""
    system = make_system(name)
    nominal = system.default_parameters()
    side = system.upright + math.pi / 2
    zero = torch.tensor(0.0, dtype=torch.float64)
    heavier = system.with_payload(torch.tensor(0.01, dtype=torch.float64), nominal)
    gravity = float(nominal["gravity"]) if "gravity" in nominal else 9.81
    length = float(nominal["length"]) if "length" in nominal else 0.5
    at = torch.tensor(side, dtype=torch.float64)
    gained = system.torque(at, zero, zero, heavier) - system.torque(at, zero, zero, nominal)
    assert float(gained) == pytest.approx(0.01 * gravity * length, rel=1e-9)
    assert float(system.inertia(heavier) - system.inertia(nominal)) == pytest.approx(
        0.01 * length**2, rel=1e-9
    )


@pytest.mark.parametrize("name", sorted(JOINT_SYSTEMS))
def test_picture_turns_with_the_angle(name: str):
    system = make_system(name)
    up = system.draw(np.array([system.upright, 0.0]), 0.0, 64)
    side = system.draw(np.array([system.upright + math.pi / 2, 0.0]), 0.0, 64)
    assert up.shape == (64, 64, 3)
    assert up.dtype == np.uint8
    assert up[:24].astype(int).std() > up[40:].astype(int).std()  # the tip is in the upper part
    assert not np.array_equal(up, side)


def test_wrong_names_are_told_what_exists():
    with pytest.raises(UnknownSystemError, match="rod_pendulum"):
        make_system("pendulm")
    with pytest.raises(ParameterError, match="mass"):
        make_system("rod_pendulum").parameter("mas")
