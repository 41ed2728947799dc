"""The target moves on its circle, and is measured with the arm."""

import numpy as np
import torch

from deepkoco.systems import CirclingTarget, TwoLinkArm, rk4_step


def start(phase: float, radius: float, rate: float) -> torch.Tensor:
    return torch.tensor([0.3, -0.8, 0.5, 1.0, phase, radius, rate], dtype=torch.float64)


def test_the_target_moves_on_its_circle_and_its_velocity_is_the_derivative_of_its_place():
    scene = CirclingTarget(TwoLinkArm())
    parameters, state, h = scene.default_parameters(), start(0.4, 0.7, -0.9), 5e-3
    places = []
    for _ in range(300):
        places.append(scene.measure(state, parameters)[4:].numpy())
        state = rk4_step(scene, state, torch.zeros(2, dtype=torch.float64), h, parameters)
    places = np.array(places)
    t = h * np.arange(300)
    expected = 0.7 * np.stack([np.cos(0.4 - 0.9 * t), np.sin(0.4 - 0.9 * t)], 1)
    np.testing.assert_allclose(places[:, :2], expected, atol=1e-9)
    np.testing.assert_allclose(places[1:-1, 2:], (places[2:, :2] - places[:-2, :2]) / (2 * h), atol=1e-5)


def test_the_arm_moves_as_without_a_target():
    arm, effort = TwoLinkArm(), torch.tensor([1.0, -0.3], dtype=torch.float64)
    scene, state = CirclingTarget(arm), start(0.0, 0.5, 1.0)
    slope = scene.derivative(state, effort, arm.default_parameters())
    assert torch.equal(slope[:4], arm.derivative(state[:4], effort, arm.default_parameters()))


def test_the_distance_is_zero_where_the_tip_is_and_follows_the_lengths():
    scene = CirclingTarget(TwoLinkArm())
    state = torch.tensor([0.6, 0.0, 0.0, 0.0, 0.6, 0.9, 0.0], dtype=torch.float64)
    longer = {**scene.default_parameters(), "length_2": torch.tensor(0.6, dtype=torch.float64)}
    np.testing.assert_allclose(scene.distance(state), 0.1, atol=1e-12)
    np.testing.assert_allclose(scene.distance(state, longer), 0.2, atol=1e-12)
