"""Steps of inertial parameters along which the loads of a robot change in proportion to the way."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems.motion import Motion
from deepkoco.systems.straight_steps import StraightSteps
from deepkoco.systems.trees import TreeSystem

# It moves in a plane, in which no parameter but those of the bodies changes the loads.
ARM = """<mujoco><compiler angle="radian"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0"/>
<inertial pos="0.1 0 -0.16" quat="0.9 0 0.3 0" mass="2.4" diaginertia="0.026 0.027 0.014"/>
<body name="lower" pos="0 0.1 -0.34" quat="0.8 0 0.4 0"><joint name="elbow" axis="0 1 0"/>
<inertial pos="0.03 0 -0.14" quat="0.7 0.7 0 0" mass="1.1" diaginertia="0.0092 0.009 0.0039"/>
</body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(ARM)
    return TreeSystem.from_file(path)


def names_of(arm):
    return [n for body in arm.inertial_parameters for n in body.names]


def loads(arm, names, values):
    draw = torch.Generator().manual_seed(1)
    q, v, a = (torch.randn(2, 30, generator=draw, dtype=torch.float64).unbind(0) for _ in range(3))
    none = (torch.zeros(30, dtype=torch.float64),) * 2
    given = {n: torch.tensor(float(x), dtype=torch.float64) for n, x in zip(names, values, strict=True)}
    return torch.stack(arm.needed_loads(arm.default_parameters() | given)(Motion(q, v, none), a))


def start_of(arm):
    return np.array([x for body in arm.inertial_parameters for x in body.values])


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_loads_change_in_proportion_to_the_way(arm, seed):
    names, start = names_of(arm), start_of(arm)
    rng = np.random.default_rng(seed)
    step = 0.05 * np.abs(start) * rng.uniform(-1.0, 1.0, len(start))
    step[[n.startswith("com_y") for n in names]] = 0.0
    straight = StraightSteps(arm.inertial_parameters, names)
    here, half, whole = (loads(arm, names, straight.end(start, share * step)) for share in (0.0, 0.5, 1.0))
    torch.testing.assert_close(whole - here, 2.0 * (half - here), rtol=1e-9, atol=1e-12)
    # Beside the start, it is the step.
    tiny = straight.end(start, 1e-6 * step) - start
    np.testing.assert_allclose(tiny, 1e-6 * step, rtol=1e-5, atol=1e-14)


def test_parameters_that_are_no_bodies_go_straight(arm):
    names = ["damping", "inertia_y(upper)", "friction"]
    straight, start = StraightSteps(arm.inertial_parameters, names), np.array([1.0, 0.03, 2.0])
    step = np.array([0.3, 0.01, -0.5])
    np.testing.assert_array_equal(straight.end(start, step), start + step)


def test_what_is_no_parameter_stays_where_it_is(arm):
    """The mass moves the first moment with it where the centre of mass stays."""
    names = ["mass(lower)", "inertia_x(lower)"]
    straight = StraightSteps(arm.inertial_parameters, names)
    start = np.array([1.1, 0.0092])
    end = straight.end(start, np.array([0.2, 0.0]))
    np.testing.assert_allclose(end, [1.3, 0.0092], rtol=1e-12)
