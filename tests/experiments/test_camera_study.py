"""The study of the camera chain: its units, what it reports, and an open loop of true values."""

import numpy as np
import pandas as pd
import pytest

from deepkoco.vision.chain import CHAIN
from experiments.studies.camera.camera_chain import TABLES, read_tables, reading_error, write_tables
from experiments.studies.camera.combinations import COMBINATIONS
from experiments.studies.camera.figures import FITS, geometric_mean
from experiments.studies.camera.fits import ALL, FREE, TRUE, open_loop
from experiments.studies.camera.report import KNOWS
from experiments.studies.camera.units import CAMERA, HiddenUnit, record
from experiments.studies.camera.white_pixels import with_white_pixels


@pytest.fixture(scope="module")
def taken():
    return record(HiddenUnit.draw(0), None, 3.0, 1)


def test_units_follow_from_their_seed_and_have_every_parameter_of_the_fit():
    one, again, other = (HiddenUnit.draw(seed) for seed in (1, 1, 2))
    assert one.values == again.values
    assert one.values != other.values
    assert set(one.values) == set(ALL)
    assert all(low <= one.values[name] <= high for name, (low, high) in CAMERA.items())


def test_the_true_values_read_the_angle_and_wrong_ones_do_not(taken):
    true = HiddenUnit.draw(0).values
    assert np.rad2deg(reading_error(taken, true)) < 0.4
    assert reading_error(taken, true | {"camera_delay": 0.0}) > 2.0 * reading_error(taken, true)
    nominal = {name: value for name, value in true.items() if name not in CAMERA}
    assert reading_error(taken, nominal) > 3.0 * reading_error(taken, true)


def test_the_true_values_follow_the_motion_without_a_look(taken, monkeypatch):
    monkeypatch.setattr("experiments.studies.camera.fits.OPEN_LOOP", 1.7)
    ahead = open_loop(HiddenUnit.draw(0).values, taken)
    assert ahead.t[0] >= 0.9
    assert ahead.t[-1] > 2.5
    assert np.rad2deg(ahead.rms) < 0.5


def test_combinations_by_hand():
    values = {
        "motor_constant": 0.04, "resistance": 8.0, "inertia": 2e-4, "mass": 0.05, "length": 0.04, "viscous": 2e-5,
        "coulomb": 1e-3, "actuation_delay.delay": 0.007, "camera_delay": 0.008,
    }  # fmt: skip
    found = [value(values) for _, value in COMBINATIONS.values()]
    # 0.04 / 8 / 2e-4; 9.81 * 0.002 / 2e-4; (2e-5 + 0.0016 / 8) / 2e-4; 1e-3 / 2e-4; 15 ms
    assert found == pytest.approx([25.0, 98.1, 1.1, 5.0, 0.015])


def test_the_geometric_mean_of_errors_that_differ_by_factors():
    mean, low, high = geometric_mean(np.array([0.1, 1.0, 10.0]))
    assert mean == pytest.approx(1.0)
    assert low * high == pytest.approx(1.0)


def test_every_fit_is_described_and_drawn():
    assert set(FITS) == set(KNOWS) == {*FREE, TRUE}
    assert CHAIN[0] == "camera"


def test_tables_are_read_back(tmp_path):
    tables = {name: pd.DataFrame({"seed": [0, 1], "value": [0.5, 2.0]}) for name in TABLES}
    write_tables(tables, tmp_path / "new")
    for name, table in read_tables(tmp_path / "new").items():
        pd.testing.assert_frame_equal(table, tables[name])
    assert all(table.empty for table in read_tables(tmp_path / "none").values())


def test_white_pixels_take_the_place_of_those_that_were_read(taken):
    unit = HiddenUnit.draw(0)
    log, again, other = (with_white_pixels(taken, unit, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(log.channels["bearing"].value, again.channels["bearing"].value)
    assert (log.channels["bearing"].value != other.channels["bearing"].value).any()
    # 1 ms at some radians per second, and 0.05 pixels of 48, apart.
    apart = log.channels["bearing"].value - taken.log.channels["bearing"].value
    assert 0.0 < np.std(np.angle(np.exp(1j * apart))) < 0.03
