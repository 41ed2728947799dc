"""Effects that dwarf the sensor noise, as in the demo: named, alone, and at the true value."""

import pytest

from deepkoco.diagnose import diagnose
from deepkoco.excitation.record import record
from deepkoco.unit import make_unit


@pytest.mark.study
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
