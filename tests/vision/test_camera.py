"""The camera node: what it shows is the middle of its exposure, so long before its tick."""

import math

import numpy as np
import torch

from deepkoco.graph import Input
from deepkoco.graph.model.noise import Noise
from deepkoco.vision import BackgroundSubtraction, Camera, ColourMask, EllipseFinder, Scene, angle_of_pixel
from deepkoco.vision.camera import _NOMINAL, angle_at

RATE = 500.0


def states(angle, now: float, count: int = 12) -> Input:
    """The last states of a world whose angle is a function of time."""
    t = now - torch.arange(count - 1, -1, -1, dtype=torch.float64)[None] / RATE
    speed = (angle(t + 1e-6) - angle(t - 1e-6)) / 2e-6
    data = torch.stack([angle(t), speed], -1)
    seq = torch.arange(count)[None]
    return Input(data, seq, t, t, torch.tensor([now], dtype=torch.float64))


def test_between_states_the_motion_is_a_cubic():
    seen = states(lambda t: 1.0 + t + t**2 - 2.0 * t**3, 0.1)
    time = torch.tensor([[0.0811, 0.0934]], dtype=torch.float64)
    torch.testing.assert_close(angle_at(seen, time), 1.0 + time + time**2 - 2.0 * time**3, rtol=0, atol=1e-9)


def test_outside_of_the_states_the_angle_rests():
    seen = states(lambda t: t, 0.1)
    time = torch.tensor([[-1.0, 0.2]], dtype=torch.float64)
    torch.testing.assert_close(
        angle_at(seen, time), torch.tensor([[0.1 - 11 / RATE, 0.1]], dtype=torch.float64)
    )


def test_before_the_first_message_the_start_is_shown():
    never = torch.full((1, 4), -math.inf, dtype=torch.float64)
    data = torch.tensor([[[0.7, 0.0]] * 4], dtype=torch.float64)
    seen = Input(data, -torch.arange(4, 0, -1)[None], never, never, torch.zeros(1, dtype=torch.float64))
    assert angle_at(seen, torch.tensor([[-0.01]], dtype=torch.float64)).tolist() == [[0.7]]


def test_a_picture_shows_the_mass_as_it_was_one_latency_before_the_tick():
    scene = Scene(np.full((160, 160, 3), 120, np.uint8))
    camera = Camera(50, scene, noise=0.0, flicker=0.0)
    times = {"latency": 0.012, "jitter": 0.0, "exposure": 0.008}
    own = {name: torch.tensor(value, dtype=torch.float64) for name, value in times.items()}
    speed = 10.0
    seen = states(lambda t: speed * t, 0.1, Camera.states_needed(RATE, times))
    noise = Noise(torch.zeros(1, dtype=torch.int64), torch.zeros(1, dtype=torch.int64))
    _, pictures = camera.step(own, {}, {"world": seen}, noise=noise)
    moved = BackgroundSubtraction(50, scene.backdrop).subtract(pictures[0].numpy())
    ellipse = EllipseFinder(50).ellipse(ColourMask(50, scene.backdrop).mask(moved))
    angle, _ = angle_of_pixel(*torch.from_numpy(ellipse[:2]), _NOMINAL)
    # A wrong sign of the latency, or an exposure that ends instead of being centred there, would be off by 0.04 rad.
    assert abs(float(angle) - speed * (0.1 - 0.012)) < 0.004
