"""The study of a pendulum that is identified from its log."""

import pytest

from deepkoco.fit import fit
from deepkoco.systems import make_system
from experiments.studies.diagnosis import identify_pendulum as study


def test_a_whole_log_is_simulated_from_one_state_at_its_start(monkeypatch):
    monkeypatch.setattr(study, "SECONDS", 6.0)
    monkeypatch.setattr(study, "STRETCHES", (2.0, 5.5))
    nominal = make_system("pendulum")
    true = {name: 1.1 * nominal.parameter(name).value for name in study.FITTED}
    log, _ = study.unit_logs(true, 0)
    found = fit([log], "pendulum", [*study.FITTED, *study.DELAYS])
    assert found.estimates["mass"].value == pytest.approx(true["mass"], rel=0.01)
    # The noise of the sensor is 2 mrad.
    assert study.reconstruction(found, log) < 0.008
