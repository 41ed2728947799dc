"""Sensor filter against its closed form."""

import math

import torch

from deepkoco.fit.simulate.sensor_filter import filtered
from deepkoco.fit.simulate.simulator import Nodes


def test_filtered_is_exact_on_cubics_and_keeps_lanes_without_filter():
    h, slow = 0.1, 0.07
    t = h * torch.arange(6, dtype=torch.float64)
    value, rate = t**3, 3.0 * t**2

    def lanes(x: torch.Tensor) -> torch.Tensor:
        return x[:, None, None].expand(-1, 1, 2).clone()

    nodes = Nodes((lanes(value),), (lanes(rate[:-1]),), (lanes(rate[1:]),))
    seen = filtered(nodes, torch.tensor([0.0, slow], dtype=torch.float64), h)
    # T y' + y = t^3 with the filter settled at the start: y = t^3 - 3 T t^2 + 6 T^2 t - 6 T^3.
    settled = t**3 - 3.0 * slow * t**2 + 6.0 * slow**2 * t - 6.0 * slow**3
    assert torch.allclose(seen.value[0][:, 0, 1], settled, atol=1e-12)
    assert torch.equal(seen.value[0][:, 0, 0], value)
    assert math.isclose(float(seen.left[0][2, 0, 1]), float((value[2] - settled[2]) / slow), rel_tol=1e-9)
