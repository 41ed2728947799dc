"""Starts of a push that lasts over several windows, some of which are held back: in closed form."""

import numpy as np
import pytest
import torch

from deepkoco.diagnose.causes import CAUSES
from deepkoco.diagnose.evidence.promising import SEARCHED, STARTS, promising_starts
from deepkoco.diagnose.evidence.pushed_bodies import pushes_of_bodies
from deepkoco.diagnose.evidence.screening import StartPoint
from deepkoco.diagnose.residuals.residuals import SLOTS, MissingTorque, SlotLoads
from deepkoco.fit.simulate.push import LONGEST
from deepkoco.systems.motion import PushPlace
from deepkoco.systems.parameter import Parameter

SLOT = 0.1  # [s]


class Slide:
    """One sliding body, which a force along its way loads as it is."""

    push_places = (PushPlace("cart", 0, (Parameter("x", 0.0, "N", -100.0, 100.0, 50.0, "force"),)),)

    def loads_of_push(self, index, along, positions):
        return torch.ones_like(positions[0])[None, None].repeat(3, 1, 1, 1)


def pushed(begins, lasts, force, windows=(0.0, 2.0, 4.0, 8.0)):
    """What slots of these windows show of a push, where each tells its own load alone."""
    time = np.array(windows)[:, None] + SLOT * (np.arange(SLOTS) + 0.5)
    acts = (time >= begins) & (time < begins + lasts)
    shape, slots = time.shape, np.eye(SLOTS)
    curvature = np.broadcast_to(slots[None, None, :, None, :], (len(windows), 1, SLOTS, 1, SLOTS))
    together = SlotLoads(curvature, (force * acts).reshape(len(windows), 1, SLOTS), np.zeros((1, *shape)))
    zeros = np.zeros(shape)
    log = np.zeros(len(windows), dtype=int)
    return MissingTorque(0, "N", time, log, zeros, zeros, zeros, zeros, zeros, zeros, "cart", together, None)


def best(begins, lasts):
    starts = pushes_of_bodies(Slide(), [pushed(begins, lasts, 7.0)])
    return min(starts, key=lambda p: abs(p["start"] - begins) + abs(p["duration"] - lasts))


@pytest.mark.parametrize(("begins", "lasts"), [(5.3, 3.9), (3.1, 2.0), (0.4, 4.1), (2.0, 0.3)])
def test_a_push_is_found_at_its_time_also_across_a_window_that_is_held_back(begins, lasts):
    push = best(begins, lasts)
    assert push["start"] == pytest.approx(begins, abs=1e-6)
    assert push["duration"] == pytest.approx(lasts, abs=1e-6)
    assert push["x"] == pytest.approx(7.0, rel=1e-3)


def test_no_start_is_longer_than_a_push_can_be():
    starts = pushes_of_bodies(Slide(), [pushed(0.0, 10.0, 7.0)])
    assert starts
    assert max(p["duration"] for p in starts) <= LONGEST


def test_all_starts_of_a_push_are_fitted_and_the_best_ones_of_other_causes():
    push, friction = CAUSES["body_push"], CAUSES["coulomb"]
    points = [StartPoint(cause, {}, 1e3 / (1 + k)) for cause in (push, friction) for k in range(SEARCHED)]
    kept = promising_starts(points)
    assert sum(p.cause is push for p in kept) == SEARCHED
    assert sum(p.cause is friction for p in kept) == STARTS
