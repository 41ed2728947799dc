"""Learned baseline that several diagnoses share."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco.diagnose import BaselineError, diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.healthy import learn_baseline
from deepkoco.diagnose.run_to_run import unshown
from deepkoco.fit import cut_windows
from deepkoco.fit.data.windows import window_length
from deepkoco.fit.threads import one_thread
from deepkoco.systems import ExtendedSystem, make_system
from tests.oracle.unit import hidden_log

SYSTEM = make_system("rod_pendulum")
LENGTH = window_length(SYSTEM)


@pytest.fixture(scope="module")
def log():
    return hidden_log("rod_pendulum", {"coulomb": {"torque": 0.1}}, "steps", 3, 12.0)


@pytest.fixture(scope="module")
def healthy():
    return hidden_log("rod_pendulum", {}, "chirp", 3, 12.0)


@pytest.fixture(scope="module")
def start(healthy):
    return baseline_from(SYSTEM, cut_windows([healthy], SYSTEM, LENGTH))


def test_diagnose_refuses_a_baseline_together_with_healthy_logs(log, healthy, start):
    with pytest.raises(BaselineError, match="both a baseline and 1 healthy logs are given"):
        diagnose([log], "rod_pendulum", [healthy], baseline=start, only=["coulomb"])


def test_diagnose_refuses_a_baseline_of_another_system(log, start):
    message = 'learned on "rod_pendulum", the diagnosis is of "torque_pendulum"'
    with pytest.raises(BaselineError, match=message):
        diagnose([log], "torque_pendulum", baseline=start, only=["coulomb"])


def test_diagnose_refuses_a_baseline_with_other_parameter_values(log, start):
    extended = ExtendedSystem(SYSTEM, ("lag",), {"lag.time_constant": 0.02})
    with pytest.raises(BaselineError, match=r"lag\.time_constant was 0\.0, now 0\.02 s"):
        diagnose([log], extended, baseline=start, only=["coulomb"])


@pytest.mark.study
def test_shared_baseline_gives_the_same_result_as_its_logs(log, healthy):
    with one_thread():
        learned = learn_baseline([healthy], SYSTEM, LENGTH)
    shared = diagnose([log], "rod_pendulum", baseline=learned, only=["coulomb"])
    own = diagnose([log], "rod_pendulum", [healthy], only=["coulomb"])
    assert shared.names == own.names == ("coulomb",)
    assert (shared.chi2_before, shared.chi2_after) == (own.chi2_before, own.chi2_after)


@pytest.mark.study
def test_diagnose_counts_the_floor_as_noise(healthy, log):
    """Without the floor, the likelihood would move the refit away from the learned prior."""
    learned = learn_baseline([healthy], SYSTEM, LENGTH)
    # A unit that differs from log to log would be refitted more under the small noise than under the large one.
    prior = learned.prior
    open_ = unshown(
        learned.system, prior.names, learned.healthy.fit.values, [g.fixed for g in learned.gauges]
    )
    constant = prior.covariance - open_
    learned = replace(learned, prior=replace(prior, covariance=constant))
    rough = replace(learned, floor=100.0)
    plain, wide = (
        diagnose([log], "rod_pendulum", baseline=start, only=["coulomb"]) for start in (learned, rough)
    )
    # Ten times the noise: a hundredth of the evidence, and the refit stays nearer to what was learned.
    assert wide.chi2_before == pytest.approx(plain.chi2_before / 100.0, rel=0.3)
    assert wide.candidates[0].delta_bic < 0.05 * plain.candidates[0].delta_bic

    def moved(result):
        names = learned.prior.names
        away = np.array([result.refit[n].value - learned.values[n] for n in names])
        return float(away @ np.linalg.solve(learned.prior.covariance, away))

    assert moved(wide) < 0.2 * moved(plain)
