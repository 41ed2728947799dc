"""The camera as a node: what it shows is a while ago, and not always the same while."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.graph.model.noise import Noise
from deepkoco.vision.picture import Scene, develop
from deepkoco.vision.projection import CAMERA

TIMES = {"latency": 0.008, "jitter": 0.0, "exposure": 0.006}
"""Nominal times of the camera [s]."""
SPREAD = 5.0  # standard deviations of the jitter that the window holds


class Camera(Node):
    """Pictures of the mass, uint8 (B, H, W, 3), RGB; the tick is when the driver stamps the picture.

    The middle of the exposure lies ``latency`` before the tick, plus a normal draw of ``jitter`` for each picture; the
    picture is the mean of what was there during the exposure. Between the states that it has received the motion
    is the cubic through their angles and speeds. None of these times is in a record: a fit has to find their sum.

    Parameters, beside those of `CAMERA`: ``latency``, ``jitter`` and ``exposure`` [s].

    Args:
        rate: Pictures per second [Hz].
        scene: What it looks at.
        noise: Standard deviation of a pixel, of 255.
        flicker: Standard deviation of the brightness from picture to picture, relative.
        strokes: Instants of an exposure at which the mass is drawn.
        options: As for `Node`; ``delay`` is the time of read-out.
    """

    inputs = ("world",)

    def __init__(
        self,
        rate: float,
        scene: Scene,
        noise: float = 4.0,
        flicker: float = 0.01,
        strokes: int = 6,
        **options: Any,
    ) -> None:
        super().__init__("camera", rate, **options)
        self.scene, self.noise, self.flicker, self.strokes = scene, noise, flicker, strokes

    @staticmethod
    def states_needed(world_rate: float, times: dict[str, float] | None = None) -> int:
        """Window of the connection from a world with this rate [Hz]."""
        own = TIMES | (times or {})
        reach = own["latency"] + SPREAD * own["jitter"] + 0.5 * own["exposure"]
        return math.ceil(reach * world_rate) + 2

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.from_numpy(self.scene.backdrop).expand(batch, *self.scene.backdrop.shape)

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, noise: Noise
    ) -> tuple[State, Tensor]:
        world = inputs["world"]
        batch = len(world.t_start)
        own = _NOMINAL | dict(parameters)
        middle = world.t_start - own["latency"] - own["jitter"] * noise.normal()
        gains = (1.0 + self.flicker * noise.normal()).numpy()
        grain = self.noise * noise.normal(*self.scene.backdrop.shape).numpy()
        # Mid-points of equal parts: their mean is the middle of the exposure.
        parts = (torch.arange(self.strokes, dtype=torch.float64) + 0.5) / self.strokes - 0.5
        exposure = own["exposure"].expand(batch)[:, None]
        angles = angle_at(world, middle[:, None] + parts * exposure).numpy()
        pictures = np.empty((batch, *self.scene.backdrop.shape), np.uint8)
        for b in range(batch):
            camera = {p.name: own[p.name] if own[p.name].ndim == 0 else own[p.name][b] for p in CAMERA}
            pictures[b] = develop(self.scene.expose(angles[b], camera), grain[b], float(gains[b]))
        return state, torch.from_numpy(pictures)


def angle_at(world: Input, time: Tensor) -> Tensor:
    """Angles (B, n) of a world's states (B, window, 2) at times (B, n) [s]: cubics through angles and speeds.

    Before the oldest and after the newest state the angle is that state's.
    """
    sent = world.t_sent.clone()
    known = torch.isfinite(sent)
    # The state before the first tick has always been there: it lies before the first message that has a time.
    first = torch.where(known, sent, math.inf).min(-1, keepdim=True).values
    place = torch.arange(sent.shape[1], dtype=torch.float64)
    sent = torch.where(known, sent, torch.where(torch.isfinite(first), first, 0.0) - 1.0 + 1e-6 * place)
    time = torch.minimum(torch.maximum(time, sent[:, :1]), sent[:, -1:])
    right = torch.searchsorted(sent, time.contiguous()).clamp(1, sent.shape[1] - 1)
    left = right - 1
    theta, omega = world.data[..., 0].double(), world.data[..., 1].double()
    begin, end = sent.gather(1, left), sent.gather(1, right)
    h = end - begin
    x = (time - begin) / h
    a, b = theta.gather(1, left), theta.gather(1, right)
    slope_a, slope_b = h * omega.gather(1, left), h * omega.gather(1, right)
    one = 1.0 - x
    cubic = one**2 * ((1.0 + 2.0 * x) * a + x * slope_a) + x**2 * ((3.0 - 2.0 * x) * b - one * slope_b)
    # Across the start there is a jump of time, not a motion.
    return torch.where(h > 0.5, b, cubic)


_NOMINAL = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in CAMERA} | {
    name: torch.tensor(value, dtype=torch.float64) for name, value in TIMES.items()
}
