"""Effects that dwarf the sensor noise, as in the demo: named, alone, and at the true value.

FOR THE DIAGNOSE BUILDER (from the lead; remove this paragraph when it holds): both cases come out wrong on logs of the
wall-clock unit (steps, 30 s). bias 0.5 -> "torque_bias 0.459 and gain 0.92": the refit without the cause has moved mass
and inertia many prior sd away, and the candidate fit, started only from there, stops on the flat valley along which
mass, gain and bias scale together. payload 0.4 -> "unknown", same reason. Remedy to try: where the refit's prior penalty
is large (say > 9), start every candidate also from the nominal baseline values (states from problem.fit_states), and let
the front runner converge tightly before a further cause is searched; a further cause must not win by repairing a fit that has
not converged. It also takes 120 s of CPU per log (the target is <= 8 s): profile, please.
"""

import pytest

from deepkoco.diagnose import diagnose
from deepkoco.unit import make_unit
from deepkoco.unit.record import record


@pytest.mark.parametrize(
    ("effect", "parameter", "value"),
    [("torque_bias", "effort", 0.5), ("payload", "mass", 0.4)],
)
def test_a_large_effect_is_named_alone_and_at_its_value(effect, parameter, value):
    sensor = {"rate_hz": 100, "noise_sd": {"theta": 0.002, "omega": 0.05}}
    unit = make_unit("rod_pendulum", effects={effect: {parameter: value}}, sensor=sensor, seed=11)
    log = record(unit, "steps", 30.0, clock="simulated", seed=0)
    diagnosis = diagnose([log], "rod_pendulum")
    assert diagnosis.names == (effect,)
    found = diagnosis.causes[0].parameters[f"{effect}.{parameter}"]
    assert found.value == pytest.approx(value, rel=0.05)
