"""Clips that play, strips that show the whole episode."""

import cv2
import numpy as np
import pytest

from deepkoco.envs.film import FilmError, film_strip, write_clip

FRAMES = [np.full((32, 48, 3), (k * 20, 100, 0), np.uint8) for k in range(11)]


def test_a_clip_holds_the_frames(tmp_path, capfd):
    path = tmp_path / "clip.webm"
    write_clip(path, FRAMES, 20.0)
    capture = cv2.VideoCapture(str(path))
    read = []
    while (shot := capture.read())[0]:
        read.append(cv2.cvtColor(shot[1], cv2.COLOR_BGR2RGB))
    assert len(read) == len(FRAMES)
    assert abs(int(read[10][16, 24, 0]) - 200) < 25
    assert [p.name for p in tmp_path.iterdir()] == ["clip.webm"]
    assert capfd.readouterr().err == ""


def test_a_clip_is_never_overwritten_and_never_empty(tmp_path):
    path = tmp_path / "clip.webm"
    with pytest.raises(FilmError, match="no frames"):
        write_clip(path, [], 20.0)
    path.write_bytes(b"kept")
    with pytest.raises(FileExistsError):
        write_clip(path, FRAMES, 20.0)
    assert path.read_bytes() == b"kept"


def test_a_strip_goes_from_the_first_frame_to_the_last():
    strip = film_strip(FRAMES, count=3, gap=2)
    assert strip.shape == (32, 3 * 48 + 2 * 2, 3)
    assert [strip[0, x, 0] for x in (0, 50, 100)] == [0, 100, 200]
    assert (strip[:, 48:50] == 255).all()
