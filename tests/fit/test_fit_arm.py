"""Fit of a system with two joints to motion integrated by SciPy."""

import pytest

from deepkoco.fit import FitError, fit
from tests.fit.identify_logs import LATE, TRUE, arm_log

ZEROS = (0.04, -0.03)  # of the second encoder, by log [rad]


def test_fit_recovers_parameters_of_two_joints():
    found = fit([arm_log(0)], "two_link_arm", list(TRUE))
    for name, true in TRUE.items():
        estimate = found.estimates[name]
        assert estimate.value == pytest.approx(true, rel=0.02)
        assert abs(estimate.value - true) < 4.0 * estimate.sd
    assert found.convergence.converged
    assert found.dispersion.chi2_per_sample == pytest.approx(1.0, abs=0.1)


def test_fit_recovers_a_delay_for_each_joint():
    delays = {f"actuation_delay(joint {j}).delay": late for j, late in LATE.items()}
    found = fit([arm_log(1, late=True)], "two_link_arm", ["mass_2", *delays], start=_known("mass_2"))
    assert found.estimates["mass_2"].value == pytest.approx(TRUE["mass_2"], rel=0.02)
    for name, late in delays.items():
        assert found.estimates[name].value == pytest.approx(late, abs=0.001)


@pytest.mark.study
def test_fit_recovers_the_second_encoder_zero_of_each_log():
    logs = [arm_log(seed, zero) for seed, zero in zip((2, 3), ZEROS, strict=True)]
    found = fit(logs, "two_link_arm", ["mass_2"], start=_known("mass_2"), zero_sd=0.1)
    zeros = {z.name: z for z in found.zeros}
    assert found.estimates["mass_2"].value == pytest.approx(TRUE["mass_2"], rel=0.02)
    for log, true in enumerate(ZEROS, 1):
        zero = zeros[f"zero of angle_2 of log {log}"]
        assert zero.value == pytest.approx(true, abs=4.0 * zero.sd)
        assert zero.sd < 0.01
        # A rotation of the whole arm in a horizontal plane does not change the motion, so this zero keeps its prior.
        assert zeros[f"zero of angle_1 of log {log}"].sd == pytest.approx(0.1, rel=0.01)


def test_fit_suggests_joints_for_an_effect_without_joint():
    with pytest.raises(FitError, match=r"did you mean .*coulomb\(joint 1\).torque"):
        fit([arm_log(0)], "two_link_arm", ["coulomb.torque"])


def _known(*sought: str) -> dict[str, float]:
    return {name: value for name, value in TRUE.items() if name not in sought}
