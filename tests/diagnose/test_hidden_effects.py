"""Each catalogued effect is hidden in turn in a log of the unit, and found."""

import pytest

from deepkoco.diagnose import diagnose
from deepkoco.excitation.record import record
from deepkoco.unit import make_unit
from experiments.studies.diagnosis.hidden.recorded import strength, unit_log
from tests.on_time import on_time
from tests.oracle.unit import hidden_log
from tests.studied import studied

SECONDS = 20.0

# cause: (system, excitation, what is hidden); seeds follow from the row.
HIDDEN = {
    "actuation_delay": ("rod_pendulum", "steps", {"actuation_delay": {"delay": 0.004}}),
    "sensing_delay": ("rod_pendulum", "prbs", {"sensing_delay": {"delay": 0.005}}),
    "lag": ("pendulum", "chirp", {"lag": {"time_constant": 0.001}}),
    "viscous": ("rod_pendulum", "chirp", {"viscous": {"change": 0.25}}),
    "coulomb": ("rod_pendulum", "steps", {"coulomb": {"torque": 0.04}}),
    "stribeck": (
        "rod_pendulum",
        "steps",
        {"stribeck": {"coulomb": 0.005, "breakaway": 0.12, "speed": 0.7}},
    ),
    "quadratic": ("rod_pendulum", "prbs", {"quadratic": {"drag": 0.004}}),
    "gain": ("pendulum", "steps", {"gain": {"factor": 0.6}}),
    "torque_bias": ("rod_pendulum", "prbs", {"torque_bias": {"effort": 0.015}}),
    "dead_zone": ("rod_pendulum", "steps", {"dead_zone": {"width": 0.05}}),
    "saturation": ("rod_pendulum", "chirp", {"saturation": {"limit": 1.8}}),
    "payload": ("rod_pendulum", "steps", {"payload": {"mass": 0.26}}),
    "sensor_bias": ("rod_pendulum", "chirp", {"sensor_bias": {"angle": 0.004}}),
    "sensor_scale": ("rod_pendulum", "steps", {"sensor_scale": {"factor": 1.0008}}),
    "event": (
        "rod_pendulum",
        "prbs",
        {"event": {"torque": 0.15, "start": 7.3, "duration": 0.2}},
    ),
}


@pytest.mark.parametrize("cause", studied(HIDDEN, ()))
def test_hidden_effect_is_found(cause):
    system, excitation, hidden = HIDDEN[cause]
    seed = 40 + list(HIDDEN).index(cause)
    assert 0.5 <= strength(system, hidden, excitation, seed, SECONDS) <= 3.0
    result = diagnose([unit_log(system, hidden, excitation, seed, SECONDS)], system)
    assert result.verdict in ("cause", "ambiguous")
    assert cause in result.causes[0].members
    # What the log holds beyond the noise is explained, and it pays off on windows that no fit saw.
    assert result.chi2_after < 1.1
    if cause != "event":
        assert result.gain.channels[0].extended <= 1.02 * result.gain.channels[0].refit


@pytest.mark.parametrize("seed", studied(range(20), (0,), range(10, 20)))
def test_nothing_is_named_on_a_control(seed):
    system = ("rod_pendulum", "pendulum")[seed % 2]
    excitation = ("steps", "chirp", "prbs", "bang-bang")[seed // 2 % 4]
    result = diagnose([unit_log(system, {}, excitation, seed, SECONDS)], system)
    assert result.verdict == "nothing"
    assert result.causes == ()


@pytest.mark.study
@on_time
def test_hidden_effect_is_found_in_wall_clock_time():
    spec = make_unit("rod_pendulum", effects={"coulomb": {"torque": 0.15}}, seed=3)
    result = diagnose([record(spec, "chirp", 12.0, clock="wall", seed=3)], "rod_pendulum")
    assert result.verdict == "cause"
    assert "coulomb" in result.causes[0].members
    assert result.causes[0].parameters["coulomb.torque"].value == pytest.approx(0.15, rel=0.1)


@pytest.mark.study
def test_what_the_catalogue_lacks_is_unknown():
    # A load that wanders at random, as in turbulent air; no cause has that shape.
    hidden = {"turbulence": {"size": 0.05}}
    result = diagnose([hidden_log("rod_pendulum", hidden, "steps", 61, SECONDS)], "rod_pendulum")
    assert result.verdict == "unknown"
    assert result.names == ("unknown",)
    assert result.unexplained["white"] is False


@pytest.mark.study
def test_two_effects_are_both_found():
    hidden = {"coulomb": {"torque": 0.06}, "actuation_delay": {"delay": 0.012}}
    result = diagnose([unit_log("rod_pendulum", hidden, "steps", 62, SECONDS)], "rod_pendulum")
    members = [set(c.members) for c in result.causes]
    assert len(members) == 2
    assert any("coulomb" in m for m in members)
    assert any("actuation_delay" in m for m in members)
