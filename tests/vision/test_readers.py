"""The nodes that read a picture, against the angle that was rendered."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.vision import (
    CAMERA,
    BackgroundSubtraction,
    ColourMask,
    EllipseFinder,
    Scene,
    angle_of_pixel,
    draw_backdrop,
    median_picture,
    pixel_of_angle,
)
from deepkoco.vision.picture import MASS_COLOUR, develop

NOMINAL = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in CAMERA}
LEANING = NOMINAL | {
    name: torch.tensor(value, dtype=torch.float64)
    for name, value in {
        "tilt_u": 0.15,
        "tilt_v": -0.1,
        "roll": 0.05,
        "perspective": 0.2,
        "lens": 0.03,
    }.items()
}


def read(scene: Scene, picture: np.ndarray, share: float = 0.75) -> np.ndarray:
    """The ellipse of a picture."""
    moved = BackgroundSubtraction(50, scene.backdrop).subtract(picture)
    return EllipseFinder(50, share * scene.area).ellipse(ColourMask(50, scene.backdrop).mask(moved))


@settings(max_examples=40, deadline=None)
@given(
    st.floats(-math.pi, math.pi),
    st.integers(0, 1000),
    st.floats(0.0, 5.0),
    st.sampled_from([NOMINAL, LEANING]),
)
def test_the_centre_is_found_within_a_third_of_a_pixel_or_not_at_all(angle, seed, noise, camera):
    """Behind any wall, under any noise: where a patch of the wall hides a part of the mass, nothing is reported."""
    scene, random = Scene(draw_backdrop(seed, MASS_COLOUR)), np.random.default_rng(seed)
    light = scene.expose(np.array([angle]), camera)
    found = read(scene, develop(light, random.normal(0.0, noise, light.shape)))
    if np.isnan(found).any():
        return
    u, v = pixel_of_angle(torch.tensor(angle, dtype=torch.float64), camera)
    assert math.hypot(found[0] - float(u), found[1] - float(v)) < 0.34


def test_most_pictures_of_a_cluttered_wall_are_read_and_give_the_angle():
    scene, random = Scene(draw_backdrop(1, MASS_COLOUR)), np.random.default_rng(0)
    errors = []
    for angle in random.uniform(-3.0, 3.0, 120):
        light = scene.expose(np.array([angle]), LEANING)
        found = read(scene, develop(light, random.normal(0.0, 4.0, light.shape)))
        if not np.isnan(found).any():
            seen, _ = angle_of_pixel(*torch.from_numpy(found[:2]), LEANING)
            errors.append(float(seen) - angle)
    assert len(errors) > 90
    assert np.rad2deg(np.sqrt(np.mean(np.square(errors)))) < 0.15


def test_colour_alone_is_misled_where_background_subtraction_is_not():
    """Without the background, a larger patch of the same colour on the wall is taken for the mass."""
    wall = np.full((160, 160, 3), 120, np.uint8)
    wall[5:45, 5:45] = MASS_COLOUR
    scene = Scene(wall)
    picture = develop(scene.expose(np.array([math.pi]), NOMINAL), np.zeros(wall.shape))
    u, v = pixel_of_angle(torch.tensor(math.pi, dtype=torch.float64), NOMINAL)
    grey = np.full_like(wall, 120)
    misled = EllipseFinder(50).ellipse(ColourMask(50, grey).mask(picture))
    assert math.hypot(misled[0] - float(u), misled[1] - float(v)) > 50.0
    found = read(scene, picture)
    assert math.hypot(found[0] - float(u), found[1] - float(v)) < 0.2


def test_the_axes_of_a_disc_and_of_a_blurred_one():
    """A still disc has two half axes of its radius; one that moves has a longer one, along its way."""
    scene = Scene(np.full((160, 160, 3), 120, np.uint8))
    radius = scene.radius * float(NOMINAL["scale"])
    still = read(scene, develop(scene.expose(np.array([0.0]), NOMINAL), np.zeros((160, 160, 3))))
    assert still[2:4] == pytest.approx(
        [radius, radius], abs=0.9
    )  # OpenCV draws smooth edges half a pixel farther
    arc = scene.expose(np.linspace(-0.15, 0.15, 12), NOMINAL)
    blurred = read(scene, develop(arc, np.zeros((160, 160, 3))))
    assert blurred[2] > still[2] + 1.0
    assert abs(math.sin(blurred[4])) < 0.1  # upright, the mass moves horizontally
    # The middle of the blur is the middle of the exposure, a sagitta of 48 * 0.15^2 / 6 = 0.18 px below the circle.
    assert blurred[0] == pytest.approx(79.5, abs=0.1)


def test_nothing_is_found_in_a_picture_without_the_mass():
    wall = draw_backdrop(3, MASS_COLOUR)
    noisy = develop(wall.astype(np.float32), np.random.default_rng(0).normal(0.0, 4.0, wall.shape))
    assert np.isnan(read(Scene(wall), noisy)).all()


def test_the_background_is_learned_from_a_film():
    scene, random = Scene(draw_backdrop(2, MASS_COLOUR)), np.random.default_rng(0)
    film = [
        develop(scene.expose(np.array([angle]), NOMINAL), random.normal(0.0, 4.0, scene.backdrop.shape))
        for angle in np.linspace(0.0, 6.0, 31)
    ]
    learned = median_picture(film)
    assert np.abs(learned.astype(int) - scene.backdrop).max() < 10
    with pytest.raises(ValueError, match="no pictures"):
        median_picture([])
