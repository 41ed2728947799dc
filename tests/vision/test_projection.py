"""The camera model: by hand, and there and back for any camera."""

import math

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.vision.projection import (
    CAMERA,
    SIDE,
    angle_of_pixel,
    nearest_turn,
    pixel_of_angle,
    pixel_of_point,
    point_of_pixel,
)

MIDDLE = 0.5 * (SIDE - 1)


def camera(**given_values: float) -> dict[str, torch.Tensor]:
    values = {p.name: p.value for p in CAMERA} | given_values
    return {name: torch.tensor(value, dtype=torch.float64) for name, value in values.items()}


def cameras() -> st.SearchStrategy[dict[str, torch.Tensor]]:
    small = {
        "pivot_u": (-8, 8), "pivot_v": (-8, 8), "scale": (40, 56), "roll": (-0.3, 0.3), "tilt_u": (-0.3, 0.3),
        "tilt_v": (-0.3, 0.3), "perspective": (0.0, 0.3), "lens": (-0.05, 0.05),
    }  # fmt: skip
    return st.fixed_dictionaries({n: st.floats(*ends) for n, ends in small.items()}).map(
        lambda v: camera(**v)
    )


def test_an_upright_mass_is_above_the_pivot_and_a_positive_angle_is_to_the_left():
    # Straight before the camera: 48 pixels up, then 48 to the left.
    for angle, wanted in ((0.0, (MIDDLE, MIDDLE - 48.0)), (math.pi / 2, (MIDDLE - 48.0, MIDDLE))):
        u, v = pixel_of_angle(torch.tensor(angle, dtype=torch.float64), camera(perspective=0.0))
        assert max(abs(float(u) - wanted[0]), abs(float(v) - wanted[1])) < 1e-9


def test_a_point_that_leans_back_is_nearer_to_the_pivot_by_hand():
    # tilt_u = 0.2, one arm up: q = (0, -cos 0.2, -sin 0.2), so v = -48 cos 0.2 / (1 - 0.15 sin 0.2).
    zero = torch.zeros((), dtype=torch.float64)
    _, v = pixel_of_angle(zero, camera(tilt_u=0.2))
    assert abs(float(v) - (MIDDLE - 48.0 * math.cos(0.2) / (1.0 - 0.15 * math.sin(0.2)))) < 1e-9


def test_the_lens_moves_a_pixel_outwards_by_hand():
    # 48 pixels from the middle: r = 48 / 80 = 0.6, so the factor is 1 + 0.1 * 0.36.
    zero = torch.zeros((), dtype=torch.float64)
    _, v = pixel_of_angle(zero, camera(lens=0.1))
    assert abs(float(v) - (MIDDLE - 48.0 * 1.036)) < 1e-9


@settings(max_examples=60, deadline=None)
@given(cameras(), st.floats(-1.2, 1.2), st.floats(-1.2, 1.2))
def test_a_pixel_leads_back_to_its_point(own, x, y):
    point = torch.tensor([x, y], dtype=torch.float64)
    back = point_of_pixel(*pixel_of_point(point[0], point[1], own), own)
    torch.testing.assert_close(torch.stack(back), point, rtol=0.0, atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(cameras(), st.floats(-3.1, 3.1))
def test_the_own_camera_reads_the_angle_at_one_arm(own, angle):
    theta = torch.tensor(angle, dtype=torch.float64)
    read, arms = angle_of_pixel(*pixel_of_angle(theta, own), own)
    assert abs(float(read) - angle) < 1e-6
    assert abs(float(arms) - 1.0) < 1e-6


@given(st.floats(-50.0, 50.0), st.integers(-8, 8))
def test_the_nearest_turn_undoes_turns(angle, turns):
    reference = torch.tensor(angle, dtype=torch.float64)
    away = reference + 2.0 * math.pi * turns
    assert abs(float(nearest_turn(away, reference)) - angle) < 1e-9


def test_opposite_tilts_look_alike_to_a_far_camera_only():
    angles = torch.linspace(-3.0, 3.0, 25, dtype=torch.float64)

    def difference(rho: float) -> float:
        one, other = (
            torch.stack(pixel_of_angle(angles, camera(perspective=rho, tilt_u=a))) for a in (0.15, -0.15)
        )
        return float((one - other).abs().max())

    assert difference(0.0) < 1e-9
    assert difference(0.15) > 1.0
