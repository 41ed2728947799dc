"""Effects: null values recover the system, each acts as its equation says, the file round-trips."""

import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems import (
    JOINT_SYSTEMS,
    ExtendedSystem,
    ModelFileError,
    ParameterError,
    load_model,
    make_system,
    save_model,
)
from deepkoco.systems.effects import EFFECTS


def extended(name: str, effect: str, **values: float) -> ExtendedSystem:
    return ExtendedSystem(
        make_system(name), (effect,), {f"{effect}.{key}": value for key, value in values.items()}
    )


@settings(max_examples=40, deadline=None)
@given(
    name=st.sampled_from(sorted(JOINT_SYSTEMS)),
    theta=st.floats(-7, 7),
    omega=st.floats(-9, 9),
    share=st.floats(-1, 1),
)
def test_null_values_recover_the_base_exactly(name, theta, omega, share):
    base = make_system(name)
    system = ExtendedSystem(base, tuple(EFFECTS))
    state = torch.tensor([theta, omega], dtype=torch.float64)
    command = torch.tensor(share * base.command.high, dtype=torch.float64)
    p = system.default_parameters()
    effort = system.actuate(command, p)
    assert torch.equal(effort, command)
    assert torch.equal(system.derivative(state, effort, p), base.derivative(state, command, p))
    assert torch.equal(system.measure(state, p), base.measure(state, p))
    assert all(float(value) == 0.0 for value in system.timing(p))


@pytest.mark.parametrize(
    ("effect", "values", "omega", "torque"),
    [
        ("viscous", {"change": 0.3}, 2.0, -0.6),
        ("coulomb", {"torque": 0.2}, 2.0, -0.2),
        ("coulomb", {"torque": 0.2}, -2.0, 0.2),
        ("quadratic", {"drag": 0.1}, -3.0, 0.9),
        # Forward 0.2 N m s/rad more than the system, backward 0.2 less: both loads point backward.
        ("asymmetric_viscous", {"difference": 0.4}, 3.0, -0.6),
        ("asymmetric_viscous", {"difference": 0.4}, -3.0, -0.6),
        # At speed vs the excess has fallen to 1/e: 0.2 + 0.1/e.
        ("stribeck", {"coulomb": 0.2, "breakaway": 0.1, "speed": 2.0}, 2.0, -0.2 - 0.1 / 2.718281828459045),
    ],
)
def test_load_effects_by_hand(effect, values, omega, torque):
    system = extended("torque_pendulum", effect, **values)
    p = system.default_parameters()
    at = [torch.tensor(v, dtype=torch.float64) for v in (0.0, omega, 0.0)]
    assert float(system.torque(*at, p) - system.base.torque(*at, p)) == pytest.approx(torque, rel=1e-9)


@pytest.mark.parametrize(
    ("effect", "values", "command", "effort"),
    [
        ("gain", {"factor": 0.5}, 1.2, 0.6),
        ("torque_bias", {"effort": -0.3}, 1.2, 0.9),
        ("dead_zone", {"width": 0.2}, 0.1, 0.0),
        ("dead_zone", {"width": 0.2}, -1.0, -0.8),
        ("saturation", {"limit": 1.0}, -1.7, -1.0),
    ],
)
def test_command_effects_by_hand(effect, values, command, effort):
    system = extended("rod_pendulum", effect, **values)
    got = system.actuate(torch.tensor(command, dtype=torch.float64), system.default_parameters())
    assert float(got) == pytest.approx(effort, rel=1e-12)


def test_sensor_scale_acts_before_the_zero_error():
    base = make_system("rod_pendulum")
    values = {"sensor_scale.factor": 1.1, "sensor_bias.angle": 0.05}
    system = ExtendedSystem(base, ("sensor_bias", "sensor_scale"), values)
    reading = system.measure(torch.tensor([2.0, 1.0], dtype=torch.float64), system.default_parameters())
    assert reading.tolist() == pytest.approx([2.25, 1.1])


def test_model_file_round_trips_and_is_never_overwritten(tmp_path):
    system = extended("pendulum", "lag", time_constant=0.02)
    path = tmp_path / "model.yaml"
    save_model(path, system, {"log": "a.csv"})
    read = load_model(path)
    assert read.source == path
    assert [(p.name, p.value, p.unit) for p in read.parameters] == [
        (p.name, p.value, p.unit) for p in system.parameters
    ]
    assert float(read.timing(read.default_parameters()).lag) == 0.02
    with pytest.raises(FileExistsError):
        save_model(path, system)


@pytest.mark.parametrize(
    "change",
    [
        {"version": 99},
        {"system": "rocket"},
        {"effects": ["magic"]},
        {"parameters": {"mass": 3}},
        {"parameters": {"mass": {"value": 1e9}}},
    ],
)
def test_a_garbled_model_file_is_refused(tmp_path, change):
    path = tmp_path / "model.yaml"
    save_model(path, extended("rod_pendulum", "gain", factor=0.9))
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | change))
    with pytest.raises(ModelFileError, match=r"model\.yaml"):
        load_model(path)


def test_unknown_effects_and_values_out_of_bounds_are_errors():
    with pytest.raises(ParameterError, match="known"):
        ExtendedSystem(make_system("pendulum"), ("coulom",))
    with pytest.raises(ParameterError, match="outside"):
        extended("pendulum", "payload", mass=-1.0)
