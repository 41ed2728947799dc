"""What a touch-down is: frames by closed forms, the crossing of the plane, the limits of a landing."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from deepkoco.systems.landing import DeckPose, Meeting, deck_normal, meeting, succeeded
from deepkoco.systems.landing.touchdown import crossing, relative, thrust_axis


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_a_point_of_a_turning_deck_has_no_velocity_against_it():
    """At (0.2, 0.1) on a deck that drives at 1 m/s and turns at 2 rad/s: v + 2 (-0.1, 0.2)."""
    deck = DeckPose(
        tensor(5.0, 3.0, 0.0), tensor(1.0, 0.0, 0.0), tensor(0.0, 0.0, 1.0), torch.tensor(2.0).double()
    )
    way, closing = relative(tensor(5.2, 3.1, 0.0), tensor(0.8, 0.4, 0.0), deck)
    torch.testing.assert_close(way, tensor(0.2, 0.1, 0.0))
    torch.testing.assert_close(closing, torch.zeros(3).double(), atol=1e-12, rtol=0.0)


def test_a_meeting_is_that_of_a_level_deck_turned_with_it():
    """Body and deck turned together by any rotation: height, offset, speeds and tilt stay."""
    rng = np.random.default_rng(0)
    way, closing, axis = (
        np.array([0.3, -0.4, 0.2]),
        np.array([0.6, 0.8, -0.7]),
        np.array([0.0, math.sin(0.3), math.cos(0.3)]),
    )
    for turned in Rotation.from_quat(rng.normal(size=(20, 4))):
        vectors = (turned.apply(v) for v in (way, closing, axis, [0.0, 0.0, 1.0]))
        met = meeting(*(torch.from_numpy(v) for v in vectors))
        assert [float(v) for v in met] == pytest.approx([0.2, 0.5, 0.7, 1.0, 0.3])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.4, 1.5])
def test_the_tilt_is_the_angle_also_where_it_is_small(angle: float):
    met = meeting(
        torch.zeros(3).double(),
        torch.zeros(3).double(),
        tensor(math.sin(angle), 0.0, math.cos(angle)),
        tensor(0.0, 0.0, 1.0),
    )
    assert float(met.tilt) == pytest.approx(angle, rel=1e-6, abs=1e-15)


def test_the_thrust_axis_is_that_of_a_roll_about_x_after_a_pitch_about_y():
    roll, pitch = 0.3, -0.4
    expected = Rotation.from_euler("YX", [pitch, roll]).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(thrust_axis(tensor(roll), tensor(pitch))[0].numpy(), expected, atol=1e-12)


def test_an_attitude_can_be_that_of_any_deck():
    normal = deck_normal(tensor(0.43), tensor(2.1))
    nx, ny, nz = normal.unbind(-1)
    torch.testing.assert_close(thrust_axis(-torch.asin(ny), torch.atan2(nx, nz)), normal)


@pytest.mark.parametrize(
    ("before", "now", "meets", "share"),
    [
        (0.3, -0.1, True, 0.75),
        (-0.1, 0.1, True, 0.5),
        (0.3, 0.1, False, 1.0),
        (-0.2, -0.1, False, 1.0),
        (0.0, 0.0, True, 1.0),
    ],
)
def test_feet_meet_the_plane_where_their_height_changes_its_sign(before, now, meets, share):
    found, at = crossing(tensor(before), tensor(now))
    assert bool(found) is meets
    assert float(at) == pytest.approx(share)


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({}, True),
        ({"offset": 0.16}, False),
        ({"sink": 0.81}, False),
        ({"sink": -0.1}, False),
        ({"slip": 0.51}, False),
        ({"tilt": math.radians(10.1)}, False),
    ],
)
def test_a_landing_is_within_all_limits(changed, expected):
    touch = {"height": 0.0, "offset": 0.14, "sink": 0.7, "slip": 0.49, "tilt": math.radians(9.9)} | changed
    assert bool(succeeded(Meeting(**{name: tensor(value) for name, value in touch.items()}))) is expected
