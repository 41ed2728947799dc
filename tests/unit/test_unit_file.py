"""UNIT.yaml: what is accepted, what is completed, what is refused and how it says so."""

import math
from pathlib import Path

import pytest

from deepkoco.systems import make_system
from deepkoco.systems.effects import EFFECTS
from deepkoco.unit import UnitSpec, UnitSpecError, load_unit, make_unit
from deepkoco.unit.unit_file import CARRIED


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "UNIT.yaml"
    path.write_text(text)
    return path


def test_file_is_completed_with_nominal_values(tmp_path):
    spec = load_unit(write(tmp_path, "system: rod_pendulum\nparameters: {mass: 1.1}\n"))
    assert spec.parameters == {"gravity": 10.0, "mass": 1.1, "length": 1.0, "viscous": 0.0}
    assert spec.effects == {}
    assert spec.command_limits == (-2.0, 2.0)
    assert spec.initial_state == (math.pi, 0.0)
    assert spec.sensor.noise_sd == (0.002, 0.05)


def test_torque_pendulum_hangs_at_zero():
    assert make_unit("torque_pendulum").initial_state == (0.0, 0.0)


def test_delay_is_a_number_or_a_law(tmp_path):
    laws = "{actuation_delay: {delay: {mean: 0.03, sd: 5e-3}}, sensing_delay: {delay: 0.01}}"
    text = f"system: pendulum\neffects: {laws}"
    effects = load_unit(write(tmp_path, text)).effects
    assert effects["actuation_delay"] == {"delay": 0.03, "jitter_sd": 0.005}
    assert effects["sensing_delay"] == {"delay": 0.01, "jitter_sd": 0.0}


def test_every_effect_that_a_unit_carries_out_can_be_hidden():
    for system in ("pendulum", "rod_pendulum", "torque_pendulum"):
        for name in set(CARRIED) & set(EFFECTS) - {
            "cogging"
        }:  # which a unit takes by its height, not by its phase
            effect = EFFECTS[name]
            values = {p.name: p.value for p in effect.parameters(make_system(system))}
            assert name in make_unit(system, effects={name: values}).effects


def test_json_round_trip():
    spec = make_unit("pendulum", effects={"event": {"torque": 0.01, "start": 1.0, "duration": 0.2}}, seed=4)
    assert UnitSpec.from_json(spec.to_json()) == spec


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("system: rod_pendulum\nefects: {}", ["UNIT.yaml", '"efects"', "effects"]),
        ("effects: {}", ["system: missing", "rod_pendulum"]),
        ("system: cartpole", ['"cartpole"', "rod_pendulum"]),
        ("system: rod_pendulum\neffects: {colomb: {torque: 1}}", ["effects", '"colomb"', "coulomb"]),
        ("system: rod_pendulum\neffects: {coulomb: {force: 1}}", ["effects.coulomb", '"force"', "torque"]),
        ("system: rod_pendulum\neffects: {coulomb: 0.1}", ["effects.coulomb", "0.1", "torque"]),
        ("system: rod_pendulum\neffects: {coulomb: {}}", ["effects.coulomb.torque", "missing", "N m"]),
        (
            "system: rod_pendulum\neffects: {coulomb: {torque: much}}",
            ["effects.coulomb.torque", "'much'", "N m"],
        ),
        (
            "system: rod_pendulum\neffects: {coulomb: {torque: 99}}",
            ["effects.coulomb.torque", "99 N m", "outside"],
        ),
        ("system: rod_pendulum\neffects: {coulomb: {torque: .nan}}", ["effects.coulomb.torque", "nan"]),
        ("system: rod_pendulum\neffects: {coulomb: {torque: -0.1}}", ["Coulomb friction", "-0.1 N m"]),
        ("system: rod_pendulum\neffects: {viscous: {change: -0.1}}", ["viscous friction", "negative"]),
        (
            "system: rod_pendulum\neffects: {sensing_delay: {delay: {average: 1}}}",
            ["effects.sensing_delay.delay", '"average"', "mean, sd"],
        ),
        ("system: rod_pendulum\nparameters: {weight: 1}", ["parameters", '"weight"', "gravity"]),
        ("system: rod_pendulum\nsensor: {rate: 5}", ["sensor", '"rate"', "rate_hz"]),
        ("system: rod_pendulum\nsensor: {noise_sd: {angle: 5}}", ["sensor.noise_sd", '"angle"', "theta"]),
        ("system: rod_pendulum\nsensor: {rate_hz: 0}", ["sensor.rate_hz", "0 Hz"]),
        ("system: rod_pendulum\ninitial_state: up", ["initial_state", "angle in rad"]),
        ("system: rod_pendulum\nseed: -1", ["seed", "-1"]),
        ("system: [", ["UNIT.yaml", "YAML"]),
        ("- 1", ["UNIT.yaml", "expected keys"]),
    ],
)
def test_error_names_file_key_and_remedy(tmp_path, text, parts):
    with pytest.raises(UnitSpecError) as caught:
        load_unit(write(tmp_path, text))
    for part in ["UNIT.yaml", *parts]:
        assert part in str(caught.value)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(UnitSpecError, match=r"none\.yaml"):
        load_unit(tmp_path / "none.yaml")


def test_system_asked_for_must_be_the_files(tmp_path):
    with pytest.raises(UnitSpecError, match='a "pendulum", asked for "rod_pendulum"'):
        load_unit(write(tmp_path, "system: pendulum"), "rod_pendulum")


def test_shipped_examples_are_units():
    files = sorted((Path(__file__).parents[2] / "configs" / "units").glob("*.yaml"))
    assert files
    for path in files:
        load_unit(path)
