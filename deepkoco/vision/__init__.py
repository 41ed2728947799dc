"""A pendulum seen by a camera: pictures, the nodes that read them (OpenCV), and what a fit knows of the camera."""

from deepkoco.vision.backdrop import draw_backdrop, median_picture
from deepkoco.vision.camera import Camera
from deepkoco.vision.chain import camera_chain, seen_log, source_starts
from deepkoco.vision.identify_seen import identify_seen, known_of_sensors
from deepkoco.vision.picture import Scene
from deepkoco.vision.projection import CAMERA, angle_of_pixel, pixel_of_angle
from deepkoco.vision.readers import AngleReader, BackgroundSubtraction, ColourMask, EllipseFinder
from deepkoco.vision.seen_pendulum import SeenPendulum
from deepkoco.vision.tachometer import Tachometer

__all__ = [
    "CAMERA",
    "AngleReader",
    "BackgroundSubtraction",
    "Camera",
    "ColourMask",
    "EllipseFinder",
    "Scene",
    "SeenPendulum",
    "Tachometer",
    "angle_of_pixel",
    "camera_chain",
    "draw_backdrop",
    "identify_seen",
    "known_of_sensors",
    "median_picture",
    "pixel_of_angle",
    "seen_log",
    "source_starts",
]
