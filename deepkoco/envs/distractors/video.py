"""A folder of videos behind the task."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np

from deepkoco.envs.distractors.clips import Clips
from deepkoco.envs.distractors.options import DistractorError, Setup

VIDEOS = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".webm")
PICTURES = (".bmp", ".jpeg", ".jpg", ".png")


def video(setup: Setup) -> Clips:
    """Plays the videos of a folder there and back, cut to a square and resized by area.

    Raises:
        DistractorError: There is no folder or no video for this split, or a video cannot be read.

    Source: Stone et al., The Distracting Control Suite (2021), section 3.1.
    """
    files, options = split_videos(setup), setup.options
    for file in files:  # a video that cannot be read is told before work starts
        read_video(file, setup.size, options.video_frames)
    clip = partial(_clip, tuple(files), setup.size, options.video_frames)
    return Clips(setup, clip, len(files), there_and_back=True)


def _clip(files: tuple[Path, ...], size: int, most: int, number: int) -> np.ndarray:
    return read_video(files[number], size, most)


def split_videos(setup: Setup) -> list[Path]:
    """The videos of a split, sorted by name.

    Raises:
        DistractorError: There is no folder, or no video for this split.
    """
    options, evaluation = setup.options, setup.split == "evaluation"
    if options.videos is None:
        raise DistractorError(
            "distractors = video: give the folder of videos as distractor_options.videos=FOLDER"
        )
    if options.evaluation_videos is not None:
        name = "evaluation_videos" if evaluation else "videos"
        return list_videos(getattr(options, name), name)
    found = list_videos(options.videos, "videos")
    if len(found) < 2:
        raise DistractorError(
            f"distractor_options.videos = {options.videos}: one video only; add another one for evaluation, "
            "or give distractor_options.evaluation_videos"
        )
    # The second, fifth, eighth ...: already the smallest folder has one for either split.
    return [file for k, file in enumerate(found) if (k % 3 == 1) == evaluation]


def list_videos(folder: str, option: str) -> list[Path]:
    """Videos in a folder, and folders of pictures in it, sorted by name.

    Raises:
        DistractorError: There is no such folder, or nothing in it.
    """
    path = Path(folder)
    if not path.is_dir():
        raise DistractorError(f"distractor_options.{option} = {folder}: no such folder")
    found = [p for p in sorted(path.iterdir()) if p.suffix.lower() in VIDEOS or (p.is_dir() and _pictures(p))]
    if not found:
        raise DistractorError(
            f"distractor_options.{option} = {folder}: no video in it; known are {', '.join(VIDEOS)} and folders "
            f"of pictures ({', '.join(PICTURES)})"
        )
    return found


@lru_cache(maxsize=128)  # 3 MiB each at 64 x 64 and 256 pictures
def read_video(file: Path, size: int, most: int) -> np.ndarray:
    """The first pictures of a video, uint8 (F, size, size, 3) RGB, not to be written into.

    Raises:
        DistractorError: OpenCV reads no picture of it.
    """
    pictures = []
    for picture in _pictures_of(file):
        height, width = picture.shape[:2]
        side = min(height, width)
        top, left = (height - side) // 2, (width - side) // 2
        square = picture[top : top + side, left : left + side]
        small = cv2.resize(square, (size, size), interpolation=cv2.INTER_AREA)
        pictures.append(cv2.cvtColor(small, cv2.COLOR_BGR2RGB))
        if len(pictures) == most:
            break
    if not pictures:
        raise DistractorError(f"{file}: OpenCV reads no picture of it; convert it or take it away")
    clip = np.stack(pictures)
    clip.flags.writeable = False
    return clip


def _pictures(folder: Path) -> list[Path]:
    return [p for p in sorted(folder.iterdir()) if p.suffix.lower() in PICTURES]


def _pictures_of(file: Path) -> Iterator[np.ndarray]:
    """Pictures BGR of a video or of a folder of pictures."""
    if file.is_dir():
        for path in _pictures(file):
            picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
            if picture is None:
                raise DistractorError(f"{path}: OpenCV cannot read this picture; convert it or take it away")
            yield picture
        return
    capture = cv2.VideoCapture(str(file))
    try:
        while True:
            there, picture = capture.read()
            if not there:
                return
            yield picture
    finally:
        capture.release()
