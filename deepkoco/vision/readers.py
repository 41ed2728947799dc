"""The nodes that read a picture, one step each: what moved, what has the colour, the ellipse, the angle.

OpenCV does the work, picture by picture, so these nodes run eagerly; the compiled executor does not take them. Each
waits for the picture of the one before (`blocking` connections), so a picture is read once and none is skipped.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.vision.picture import MASS_COLOUR
from deepkoco.vision.projection import CAMERA, SIDE, angle_of_pixel, nearest_turn

ELLIPSE = ("u", "v", "major", "minor", "rotation", "area")
"""Columns of what an `EllipseFinder` puts out: centre and half axes [px], rotation [rad], area [px2]."""


class BackgroundSubtraction(Node):
    """Blackens what looks as the background does; output uint8 (B, H, W, 3).

    Args:
        rate: Of the camera [Hz].
        background: uint8 (H, W, 3), as `median_picture` finds it.
        threshold: Largest difference of a channel that is still background, of 255.
        options: As for `Node`.
    """

    inputs = ("camera",)

    def __init__(self, rate: float, background: np.ndarray, threshold: int = 18, **options: Any) -> None:
        super().__init__("moved", rate, **options)
        self.background, self.threshold = background, threshold

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.zeros(batch, *self.background.shape, dtype=torch.uint8)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        pictures = inputs["camera"].data[:, -1].numpy()
        return state, torch.from_numpy(np.stack([self.subtract(picture) for picture in pictures]))

    def subtract(self, picture: np.ndarray) -> np.ndarray:
        """The picture (H, W, 3) with its background black."""
        change = cv2.absdiff(picture, self.background).max(-1)
        moved = (change > self.threshold).astype(np.uint8)
        return cv2.bitwise_and(picture, picture, mask=moved)


class ColourMask(Node):
    """How much of each pixel the mass covers, 0 to 255, where a patch has its hue; output uint8 (B, H, W).

    At the edge of the mass a pixel is a mixture of mass and background, I = (1 - share) B + share C. Its share is the
    least-squares one over the three colours. A threshold instead moves the edge by what stands behind it: on the walls
    of `draw_backdrop` the middle of the mass was then wrong by 0.25 pixels (root mean square).

    Args:
        rate: Of the camera [Hz].
        background: uint8 (H, W, 3), as for `BackgroundSubtraction`.
        colour: RGB of the mass.
        hue: Largest difference of the hue, of OpenCV's 180 to the circle.
        saturation: Least saturation, of 255.
        contrast: Least distance between background and mass in RGB. A patch that touches a place with less is left out:
            what is hidden there would move its middle, by up to 2 pixels.
        options: As for `Node`.
    """

    inputs = ("moved",)

    def __init__(
        self,
        rate: float,
        background: np.ndarray,
        colour: tuple[int, int, int] = MASS_COLOUR,
        hue: int = 10,
        saturation: int = 90,
        contrast: float = 40.0,
        **options: Any,
    ) -> None:
        super().__init__("coloured", rate, **options)
        self.hue, self.saturation = hue, saturation
        self.wanted = int(cv2.cvtColor(np.array([[colour]], np.uint8), cv2.COLOR_RGB2HSV)[0, 0, 0])
        self.background = background.astype(np.float32)
        way = np.array(colour, np.float32) - self.background
        square = (way**2).sum(-1)
        self.direction = way / square.clip(1.0)[..., None]
        self.blind = square <= contrast**2
        self.stray = np.ones((3, 3), np.uint8)  # what is smaller is noise
        self.around = np.ones((5, 5), np.uint8)  # a patch and the mixed pixels at its edge

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.zeros(batch, *self.background.shape[:2], dtype=torch.uint8)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        pictures = inputs["moved"].data[:, -1].numpy()
        return state, torch.from_numpy(np.stack([self.mask(picture) for picture in pictures]))

    def mask(self, picture: np.ndarray) -> np.ndarray:
        """Shares uint8 (H, W) of a picture (H, W, 3) whose background is black."""
        found = cv2.cvtColor(picture, cv2.COLOR_RGB2HSV)
        # Hues are on a circle: turned so that the wanted one stands in its middle, none wraps.
        found[..., 0] = (found[..., 0].astype(np.int16) - self.wanted + 90) % 180
        low, high = (90 - self.hue, self.saturation, 30), (90 + self.hue, 255, 255)
        patches = cv2.morphologyEx(cv2.inRange(found, low, high), cv2.MORPH_OPEN, self.stray)
        patches = cv2.dilate(patches, self.around)
        _, labels = cv2.connectedComponents(patches)
        near = (
            (patches > 0) & picture.any(-1) & ~np.isin(labels, np.unique(labels[self.blind & (labels > 0)]))
        )
        share = ((picture.astype(np.float32) - self.background) * self.direction).sum(-1)
        return np.where(near, np.rint(255.0 * share.clip(0.0, 1.0)), 0.0).astype(np.uint8)


class EllipseFinder(Node):
    """The ellipse with the moments of the largest patch, pixels weighed by their shares.

    Output (B, 6), see `ELLIPSE`; NaN where there is no patch.

    Args:
        rate: Of the camera [Hz].
        least: Smallest sum of shares that counts [px2].
        options: As for `Node`.
    """

    inputs = ("coloured",)
    finite = False

    def __init__(self, rate: float, least: float = 12.0, **options: Any) -> None:
        super().__init__("ellipse", rate, **options)
        self.least = least

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.full((batch, len(ELLIPSE)), math.nan, dtype=torch.float64)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        masks = inputs["coloured"].data[:, -1].numpy()
        return state, torch.from_numpy(np.stack([self.ellipse(mask) for mask in masks]))

    def ellipse(self, mask: np.ndarray) -> np.ndarray:
        """The ellipse (6,) of shares (H, W), uint8."""
        nothing = np.full(len(ELLIPSE), math.nan)
        count, labels, found, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        if count < 2:
            return nothing
        largest = 1 + int(found[1:, cv2.CC_STAT_AREA].argmax())
        m = cv2.moments(np.where(labels == largest, mask / np.float32(255.0), np.float32(0.0)))
        if m["m00"] < self.least:
            return nothing
        u, v = m["m10"] / m["m00"], m["m01"] / m["m00"]
        # A full ellipse with half axes a, b has the variances a^2 / 4, b^2 / 4; a pixel alone has 1/12.
        xx, xy, yy = m["mu20"] / m["m00"] + 1 / 12, m["mu11"] / m["m00"], m["mu02"] / m["m00"] + 1 / 12
        spread = math.hypot(0.5 * (xx - yy), xy)
        major, minor = (2.0 * math.sqrt(max(0.5 * (xx + yy) + sign * spread, 0.0)) for sign in (1.0, -1.0))
        return np.array([u, v, major, minor, 0.5 * math.atan2(2.0 * xy, xx - yy), m["m00"]])


class AngleReader(Node):
    """Angle [rad] and distance from the pivot [arms] of the centre of an ellipse, (B, 2), as one camera sees them.

    The angle goes on from the last one over the top; where nothing was found both are NaN. The distance is 1 for a
    camera that is known.

    Parameters: those of `CAMERA` that are not nominal.

    Args:
        rate: Of the camera [Hz].
        side: Width and height of the picture [px].
        options: As for `Node`.
    """

    inputs = ("ellipse",)
    finite = False

    def __init__(self, rate: float, side: int = SIDE, **options: Any) -> None:
        super().__init__("angle", rate, **options)
        self.side = side

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"last": torch.zeros(batch, dtype=torch.float64)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.full((batch, 2), math.nan, dtype=torch.float64)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        u, v = inputs["ellipse"].data[:, -1, 0], inputs["ellipse"].data[:, -1, 1]
        angle, arms = angle_of_pixel(u, v, _NOMINAL | dict(parameters), self.side)
        angle = nearest_turn(angle, state["last"])
        last = torch.where(torch.isnan(angle), state["last"], angle)
        return {"last": last}, torch.stack([angle, arms], -1)


_NOMINAL = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in CAMERA}
