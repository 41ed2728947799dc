"""Lines in the spectrum of a missing load."""

import numpy as np
import pytest

from deepkoco.diagnose.residuals.residuals import MissingTorque
from deepkoco.diagnose.residuals.spectrum import spectrum_of


def missing(load) -> tuple[MissingTorque]:
    windows, slots, slot = 10, 20, 0.08
    time = (1.7 * np.arange(windows))[:, None] + slot * (np.arange(slots) + 0.5)
    torque = load(time)
    zero = np.zeros_like(time)
    log = np.zeros(windows, dtype=int)
    return (MissingTorque(0, "N m", time, log, torque, zero + 0.1, zero, zero, zero, zero),)


def test_spectrum_finds_the_frequency_of_a_sine():
    noise = np.random.default_rng(0).standard_normal((10, 20))
    found = spectrum_of(missing(lambda t: np.sin(9.0 * t) + 0.3 * noise))
    assert found["peak_rad_s"] == pytest.approx(9.0, abs=0.2)
    # A sine of power 1/2 over noise of 0.09 takes 0.5 / 0.59 of the whole.
    assert found["peak_share"] == pytest.approx(0.5 / 0.59, abs=0.05)


@pytest.mark.parametrize("windows", [20, 200])
def test_spectrum_finds_a_line_in_logs_of_any_length(windows):
    slot, slots = 0.1, 15
    time = (slots * slot * np.arange(windows))[:, None] + slot * (np.arange(slots) + 0.5)
    noise = 0.5 * np.random.default_rng(2).standard_normal(time.shape)
    zero, log = np.zeros_like(time), np.zeros(windows, dtype=int)
    for frequency in (2.3, 5.01, 11.7):
        load = np.sin(frequency * time) + noise
        found = spectrum_of([MissingTorque(0, "N m", time, log, load, zero + 0.5, zero, zero, zero, zero)])
        assert found["peak_rad_s"] == pytest.approx(frequency, abs=2.0 / np.ptp(time))
        # 0.5 of 0.75 is the sine's; an eighth of an independent frequency away a tenth of it is lost at most.
        assert found["peak_share"] > 0.55


def test_spectrum_of_noise_stays_below_the_chance_share():
    draws = np.random.default_rng(1).standard_normal((100, 10, 20))
    above = [
        found["peak_share"] > found["chance_share"]
        for found in (spectrum_of(missing(lambda t, d=d: d)) for d in draws)
    ]
    assert sum(above) <= 6
