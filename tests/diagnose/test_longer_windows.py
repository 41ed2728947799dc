"""Causes that were selected on short windows are fitted on longer ones, where the simulation then follows."""

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.window_choice import followed_length
from deepkoco.fit.data.windows import window_length
from deepkoco.logs.recording import Recording, Series
from experiments.studies.diagnosis.logs_of_others.emps import Emps

MASS, VISCOUS, DRY, OFFSET = 95.0, 203.0, 60.0, 5.0
PERIOD, SECONDS = 1e-3, 12.0


def record(seed) -> Recording:
    """A car of known friction under a controller that follows slow and fast strokes, with encoder noise."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(round(SECONDS / PERIOD))
    sweep = np.cumsum(0.4 + 0.25 * np.sin(0.7 * t)) * PERIOD
    goal = 0.05 * np.sin(2.0 * np.pi * sweep)
    q, force = np.zeros_like(t), np.zeros_like(t)
    position, velocity = goal[0], 0.0
    for k in range(len(t)):
        q[k] = position
        force[k] = np.clip(243.0 * 35.15 * (1.6 * (goal[k] - position) - 0.1 * velocity), -350.0, 350.0)
        for _ in range(50):
            drive = force[k] - VISCOUS * velocity + OFFSET
            moved = velocity + 2e-5 * (drive - DRY * np.sign(velocity)) / MASS
            # The car comes to rest within a step, and leaves rest only against more than its dry friction.
            stops = moved * velocity < 0.0 or (velocity == 0.0 and abs(drive) <= DRY)
            velocity = 0.0 if stops else moved
            position += 2e-5 * velocity
    q += 2e-6 * rng.standard_normal(len(q))
    return Recording({"force": Series(t, force, "N", "command"), "q": Series(t, q, "m", "measurement")})


@pytest.mark.study
@pytest.mark.timeout(600)
def test_parameters_are_those_of_windows_of_the_usual_length():
    system, log = Emps(), record(39000)
    usual = window_length(system)
    assert followed_length([log], system) < usual
    found = diagnose([log], system)
    assert found.window_s == pytest.approx(usual)
    assert {cause.name for cause in found.causes} == {"coulomb", "torque_bias"}
    size = {p: e.value for cause in found.causes for p, e in cause.parameters.items()}
    final = found.to_json()["fit"]["final"]["mass"]
    assert size["coulomb.torque"] == pytest.approx(DRY, rel=2e-3)
    assert size["torque_bias.effort"] == pytest.approx(OFFSET, rel=2e-3)
    assert final["value"] == pytest.approx(MASS, rel=2e-3)
