"""Pictures of a turning mass as a camera takes them: exposure, noise, a still background."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.parameter import Parameters
from deepkoco.vision.projection import CAMERA, pixel_of_point

CORNERS = 32  # of the polygon that stands for the mass
SHIFT = 4  # binary digits of a pixel in which OpenCV takes coordinates
MASS_COLOUR = (214, 84, 32)  # RGB


@dataclass(frozen=True)
class Scene:
    """What a camera looks at.

    Attributes:
        backdrop: uint8 (H, W, 3), RGB, H = W.
        colour: RGB of the mass.
        radius: Of the mass [arms].
    """

    backdrop: np.ndarray
    colour: tuple[int, int, int] = MASS_COLOUR
    radius: float = 0.17

    @property
    def side(self) -> int:
        """Width and height [px]."""
        return self.backdrop.shape[0]

    @property
    def area(self) -> float:
        """Of the mass before the nominal camera [px2]."""
        scale = next(p.value for p in CAMERA if p.name == "scale")
        return math.pi * (self.radius * scale) ** 2

    def expose(self, angles: np.ndarray, camera: Parameters) -> np.ndarray:
        """Light (H, W, 3) of one exposure, float32 in [0, 255], without noise.

        Args:
            angles: (n,) angles at even times of the exposure [rad].
            camera: Parameters of the camera, scalars.
        """
        cover = np.zeros((self.side, self.side), np.float32)
        one = np.empty((self.side, self.side), np.uint8)
        for outline in self._outlines(torch.from_numpy(np.atleast_1d(angles)), camera):
            one[:] = 0
            cv2.fillPoly(one, [np.round(outline * 2**SHIFT).astype(np.int32)], 255, cv2.LINE_AA, SHIFT)
            cover += one
        share = (cover / (255.0 * len(np.atleast_1d(angles))))[..., None]
        return (self.backdrop + share * (np.array(self.colour, np.float32) - self.backdrop)).astype(
            np.float32
        )

    def _outlines(self, angles: Tensor, camera: Parameters) -> np.ndarray:
        """Corners (n, CORNERS, 2) of the mass [px]."""
        round_ = torch.arange(CORNERS, dtype=torch.float64) * (2.0 * math.pi / CORNERS)
        x = -torch.sin(angles)[:, None] + self.radius * torch.cos(round_)
        y = -torch.cos(angles)[:, None] + self.radius * torch.sin(round_)
        return torch.stack(pixel_of_point(x, y, camera, self.side), -1).numpy()


def develop(light: np.ndarray, noise: np.ndarray, gain: float = 1.0) -> np.ndarray:
    """The picture uint8 (H, W, 3) of light (H, W, 3) with noise (H, W, 3) of the sensor and a gain of the exposure."""
    return np.clip(np.rint(gain * light + noise), 0.0, 255.0).astype(np.uint8)
