"""A system that stands on another one passes on all that it does not change itself."""

import inspect

import pytest
import torch

from deepkoco.systems import ExtendedSystem, System, make_system
from deepkoco.systems.with_speeds import WithSpeeds, missing_speeds
from deepkoco.systems.wrapped import WrappedSystem

# Computed from the joints and channels of the system itself.
OWN = {
    "at_command",
    "at_joint",
    "coupled_joints",
    "default_parameters",
    "draw",
    "free_commands",
    "load_units",
    "parameter",
    "per_speed_squared_units",
    "per_speed_units",
    "shows_states",
    "speeds_of_positions",
    "timing_at",
}


def test_every_method_of_a_system_is_passed_on_or_computed_from_what_is():
    methods = {
        name
        for name, member in inspect.getmembers(System)
        if not name.startswith("_") and (callable(member) or isinstance(member, property))
    }
    assert methods - OWN <= set(vars(WrappedSystem))


@pytest.mark.parametrize("name", ["servo_pendulum", "furuta_pendulum", "two_link_arm", "quadrotor_height"])
def test_wrapped_system_passes_on_its_actuators_timing_and_tilt(name):
    base = make_system(name)
    extended = ExtendedSystem(base, ())
    wrapped = WithSpeeds(extended, 100.0) if missing_speeds(extended) else extended
    parameters = base.default_parameters()
    assert wrapped.tilt_parameters == base.tilt_parameters
    assert wrapped.delivered_scales == base.delivered_scales
    assert wrapped.resizable == base.resizable
    for index in range(len(base.commands)):
        assert wrapped.command_timing(index, parameters) == base.command_timing(index, parameters)
    state = torch.zeros(3, len(base.state_names), dtype=torch.float64)
    at = wrapped.measure_at(state, torch.zeros(3, dtype=torch.float64), parameters)
    assert torch.equal(at, wrapped.measure(state, parameters))
    assert at.shape[-1] == len(wrapped.measurements)
