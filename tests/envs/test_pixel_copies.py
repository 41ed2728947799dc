"""Where copies are drawn in a frame, and what they cover."""

import gymnasium
import numpy as np
import pytest

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.envs.distractors.options import DistractorError, DistractorOptions
from deepkoco.envs.distractors.pixel_copies import places_around, places_below
from deepkoco.envs.distractors.registry import PIXEL, make_distractors
from deepkoco.envs.pixels import VectorPixels
from deepkoco.systems import drawing


def covered(places, size: int) -> np.ndarray:
    """How many places hold each pixel (size, size)."""
    count = np.zeros((size, size), int)
    for place in places:
        count[place] += 1
    return count


def test_four_copies_around_take_the_corners_of_a_grid_of_three():
    task, places = places_around(63, 4)
    assert task == (slice(21, 42), slice(21, 42))
    corners = [(0, 0), (0, 42), (42, 0), (42, 42)]
    assert places == [(slice(top, top + 21), slice(left, left + 21)) for top, left in corners]


@pytest.mark.parametrize("copies", [1, 4, 8, 9, 24, 25])
def test_without_occlusion_no_two_places_overlap(copies):
    task, places = places_around(64, copies)
    assert len(places) == copies
    assert covered([task, *places], 64).max() == 1
    assert covered(places_below(64, copies), 64).max() == 1


def test_with_occlusion_half_every_place_is_half_as_wide_as_the_frame():
    task, places = places_around(64, 4, 0.5)
    assert task == (slice(16, 48), slice(16, 48))
    assert covered(places, 64)[task].all()  # each corner of the task's place lies under one copy
    assert covered(places, 64).max() == 1


def frames(distractors: str, options: DistractorOptions | None = None) -> np.ndarray:
    """Frames (5, 3, 64, 64, 3) of three pendulums that nobody pushes."""
    envs = gymnasium.make_vec("deepkoco/RodPendulum-v0", 3, vectorization_mode="vector_entry_point")
    made = make_distractors(PIXEL, distractors, 3, options or DistractorOptions(), "rod_pendulum", "train")
    envs = VectorPixels(envs, list(made.values()))
    seen = [envs.reset(seed=1)[0]]
    seen += [envs.step(np.zeros((3, 1), np.float32))[0] for _ in range(4)]
    return np.array(seen)


def test_the_task_is_in_the_middle_and_as_large_as_the_copies():
    options = DistractorOptions(layout="around")
    seen, alone = (
        frames("copies", options),
        frames("copies", DistractorOptions(layout="around", intensity=0.0)),
    )
    (rows, columns), places = places_around(64, 4)
    drawn = (alone != drawing.BACKGROUND).any((0, 1, 4))
    assert drawn[rows, columns].any()
    assert drawn.sum() == drawn[rows, columns].sum()
    assert np.array_equal(seen[:, :, rows, columns], alone[:, :, rows, columns])
    assert all((seen[:, :, r, c] != alone[:, :, r, c]).any() for r, c in places)


def test_with_occlusion_copies_cover_parts_of_the_task():
    options = {"layout": "around", "occlusion": 0.5}
    seen = frames("copies", DistractorOptions(**options))
    alone = frames("copies", DistractorOptions(**options, intensity=0.0))
    changed = (seen != alone).any((0, 1, 4))
    assert changed[places_around(64, 4, 0.5)[0]].any()


def test_a_background_lies_below_all_of_them():
    seen = frames("background+copies", DistractorOptions(layout="around", intensities={"copies": 0.0}))
    moved = (seen[1:] != seen[:-1]).any(-1).mean((0, 1))
    assert (moved > 0).mean() > 0.95


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"layout": "beside"}, 'layout = "beside"; choose one of below, around'),
        ({"layout": "around", "occlusion": 1.5}, "occlusion = 1.5; give a number from 0 to 1"),
        ({"occlusion": 0.5}, 'occlusion = 0.5 needs distractor_options.layout = "around"'),
    ],
)
def test_layouts_that_are_none_are_refused(options, message):
    with pytest.raises(DistractorError) as error:
        DistractorOptions(**options).check()
    assert message in str(error.value)
