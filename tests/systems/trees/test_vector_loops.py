"""The loops over the lanes of a block are vector instructions: simulations of arms spend most of their time there."""

import re

import numpy as np
import pytest
from numba import njit

from deepkoco.systems.block_sizes import LANES, in_lanes, in_rows
from deepkoco.systems.trees.mass_matrix_kernel import fill_mass, gather_inertias
from deepkoco.systems.trees.newton_euler_kernel import ROWS, SPARE, gather_forces, move_frames


def of_forces(s, spare, mass, parent, turns, rotation):
    gather_forces(in_rows(s, ROWS), in_lanes(spare), parent, turns, rotation)


def of_frames(s, spare, mass, parent, turns, rotation):
    move_frames(in_rows(s, ROWS), in_lanes(spare), parent, turns, rotation, in_lanes(spare))


def of_inertias(s, spare, mass, parent, turns, rotation):
    gather_inertias(in_rows(s, ROWS), in_lanes(spare), parent, rotation)


def of_masses(s, spare, mass, parent, turns, rotation):
    which = np.arange(LANES)
    fill_mass(in_rows(s, ROWS), in_lanes(spare), in_lanes(mass), parent, turns, rotation, mass, which)


@pytest.mark.parametrize(
    ("part", "products"), [(of_forces, 48), (of_frames, 116), (of_inertias, 82), (of_masses, 34)]
)
def test_loops_over_lanes_are_vector_instructions(part, products):
    joints = 3
    arrays = [np.ones((joints + 1, ROWS, LANES)), np.ones((SPARE, LANES)), np.ones((joints, joints, LANES))]
    compiled = njit(error_model="numpy")(part)
    compiled(*arrays, np.array([3, 0, 1]), np.ones(joints), np.ones((joints, 9)))
    (code,) = compiled.inspect_llvm().values()
    vectors = len(re.findall(r"= fmul <\d+ x double>", code))
    # Every product of the loops stands there as a vector, more than once where a processor has narrow vectors. How
    # many of them also stand there one by one, for rows that overlap, depends on the processor and tells nothing.
    assert vectors >= 0.9 * products


def test_known_sizes_change_no_values():
    table = np.arange(2.0 * 3 * LANES).reshape(2, 3, LANES)

    @njit
    def same(table):
        known = in_rows(table, 3)
        known[1, 2, 4] = -1.0
        return in_lanes(known)

    found = same(table)
    assert found.shape == table.shape
    assert table[1, 2, 4] == -1.0
    np.testing.assert_array_equal(found, table)
