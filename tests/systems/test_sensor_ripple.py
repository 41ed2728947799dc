"""Readings that err with the angle: the speed that is shown is the derivative of the position that is shown."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.effects import effects_of


@settings(deadline=None)
@given(
    angle=st.floats(-10.0, 10.0),
    speed=st.floats(-5.0, 5.0),
    sine=st.floats(-0.1, 0.1),
    cosine=st.floats(-0.1, 0.1),
    cycles=st.sampled_from([1.0, 2.0, 5.0]),
)
def test_the_speed_is_the_derivative_of_the_position(angle, speed, sine, cosine, cycles):
    system = ExtendedSystem(make_system("rod_pendulum"), ("sensor_ripple",))
    own = {"sensor_ripple.sine": sine, "sensor_ripple.cosine": cosine, "sensor_ripple.cycles": cycles}
    parameters = {
        p.name: torch.tensor(own.get(p.name, p.value), dtype=torch.float64) for p in system.parameters
    }
    time = torch.zeros((), dtype=torch.float64, requires_grad=True)
    state = torch.stack([angle + speed * time, torch.tensor(speed, dtype=torch.float64)])
    shown = system.measure(state, parameters)
    (slope,) = torch.autograd.grad(shown[0], time)
    torch.testing.assert_close(shown[1], slope)


def test_what_slides_has_no_turns():
    assert "sensor_ripple" not in effects_of(make_system("quadrotor_height"))
