"""The study of the quadrotor: its own flight against the system, and a short identification."""

import numpy as np
import pandas as pd
import pytest

from deepkoco.fit import fit
from experiments.studies.diagnosis import identify_quadrotor as study


def test_parameters_and_delays_of_a_short_quiet_flight_are_found(monkeypatch):
    """The flight is integrated by the study alone, so what is found says that both mean the same motion."""
    monkeypatch.setattr(study, "NOISE", (1e-4, 1e-3))
    true = study.hidden(3)
    found = fit([study.Flight(true, 0).fly(6.0)], "quadrotor", [*study.PARAMETERS, *study.DELAYS]).estimates
    for name in study.PARAMETERS:
        assert found[name].value == pytest.approx(true[name], rel=0.02)
    for name in study.DELAYS:
        assert found[name].value == pytest.approx(true[name], abs=1e-3)


def test_a_command_that_comes_within_a_step_counts_for_its_part():
    flight = study.Flight(study.hidden(0), 0)
    flight.sent = [(0.0, (1.0, 0.0, 0.0)), (0.0204, (3.0, 0.0, 0.0))]
    assert flight._held(0, 0.0200, 9.0) == pytest.approx(0.4 * 1.0 + 0.6 * 3.0)
    assert flight._held(0, -0.0003, 9.0) == pytest.approx(0.3 * 9.0 + 0.7 * 1.0)
    assert flight._held(0, -0.5, 9.0) == pytest.approx(9.0)


def test_errors_are_counted_against_the_goals():
    rows = []
    for late in (0.5e-3, 2e-3):
        row = {}
        for name in (*study.PARAMETERS, *study.DELAYS):
            error = late if name in study.DELAYS else 0.03
            row |= {
                f"{name} true": 1.0,
                f"{name} found": 1.0 + error,
                f"{name} low": 0.99,
                f"{name} high": 1.001,
            }
        rows.append(row)
    table = study.errors(pd.DataFrame(rows)).set_index("name")
    assert table.loc["mass", "reached"] == 0
    assert table.loc["roll_delay", "reached"] == 1
    assert table.loc["roll_delay", "largest"] == pytest.approx(2e-3)
    assert np.all(table["inside"] == 2)
