"""The vehicle under a deck: arcs, the spread of its turn rate, and the frame that turns with it."""

import math

import pytest
import torch

from deepkoco.systems.landing import DeckPose, carried, deck_normal, deck_parameters, drive_on

STEADY = {"turn_spread": torch.tensor(0.5).double(), "turn_time": torch.tensor(1e9).double()}


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_at_a_constant_turn_rate_it_drives_a_circle():
    """1 m/s at 0.5 rad/s: a radius of 2 m about (0, 2), whatever the ticks are."""
    way = tensor(0.0), tensor(0.0), tensor(0.0), tensor(1.0)
    for _ in range(7):
        way = drive_on(way, tensor(1.0), 0.3, STEADY, tensor(0.0))
    angle = 0.5 * 7 * 0.3
    expected = (2.0 * math.sin(angle), 2.0 - 2.0 * math.cos(angle), angle, 1.0)
    assert [float(value) for value in way] == pytest.approx(expected, abs=1e-6)


def test_without_a_turn_it_drives_a_line():
    way = drive_on(
        (tensor(1.0), tensor(2.0), tensor(math.pi / 2), tensor(0.0)),
        tensor(0.8),
        0.5,
        STEADY,
        tensor(0.0),
    )
    assert [float(value) for value in way] == pytest.approx([1.0, 2.4, math.pi / 2, 0.0])


def test_the_turn_rate_keeps_its_spread_whatever_the_tick():
    noise = torch.Generator().manual_seed(0)
    for dt in (0.02, 0.5):
        zero = torch.zeros(20000, dtype=torch.float64)
        start = torch.randn(20000, generator=noise, dtype=torch.float64)
        way = zero, zero, zero, start
        for _ in range(5):
            drawn = torch.randn(20000, generator=noise, dtype=torch.float64)
            way = drive_on(way, zero, dt, deck_parameters(), drawn)
        assert float(way[3].std()) == pytest.approx(1.0, rel=0.03)
        correlation = float(torch.corrcoef(torch.stack([start, way[3]]))[0, 1])
        assert correlation == pytest.approx(math.exp(-5 * dt), abs=0.03)


def test_the_normal_leans_where_the_deck_slopes_down():
    normal = deck_normal(tensor(math.radians(25.0)), tensor(math.pi / 2))
    expected = [0.0, math.sin(math.radians(25.0)), math.cos(math.radians(25.0))]
    assert normal[0].tolist() == pytest.approx(expected)


def test_a_carried_deck_is_the_driven_one_to_first_order():
    """In 1 ms, v^2 t^2 / 2 and (r t)^2 / 2 are below 1e-6."""
    later, heading, slope = 1e-3, 0.7, 1.1
    x, y, after, _ = drive_on(
        (tensor(0.0), tensor(0.0), tensor(heading), tensor(1.0)), tensor(1.0), later, STEADY, tensor(0.0)
    )
    velocity = tensor(math.cos(heading), math.sin(heading), 0.0)[None]
    now = DeckPose(
        torch.zeros(1, 3).double(), velocity, deck_normal(tensor(0.4), tensor(heading + slope)), tensor(0.5)
    )
    pose = carried(now, tensor(later))
    torch.testing.assert_close(pose.place[0, :2], torch.cat([x, y]), atol=1e-6, rtol=0.0)
    torch.testing.assert_close(pose.normal, deck_normal(tensor(0.4), after + slope), atol=1e-6, rtol=0.0)
    torch.testing.assert_close(pose.velocity[0, 0], torch.cos(after)[0], atol=1e-6, rtol=0.0)
