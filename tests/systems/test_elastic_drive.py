"""Equations of a joint whose drive gives, against two masses and a spring written down by hand."""

import math
from pathlib import Path

import pytest
import torch

from deepkoco.systems import ExtendedSystem, Motion, load_model, load_system, save_model
from deepkoco.systems.effects import effects_of
from deepkoco.systems.elastic_drive import ElasticDrive

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
SHARE, HERTZ, RATIO = 0.6, 4.0, 0.1


def numbers(*values: float) -> tuple[torch.Tensor, ...]:
    return tuple(torch.tensor(v, dtype=torch.float64) for v in values)


@pytest.fixture
def motor() -> ExtendedSystem:
    values = {"elastic.share": 0.75, "elastic.frequency": HERTZ, "elastic.damping": RATIO}
    base = load_system(f"{EXAMPLES}/motor.py:Motor")
    assert not isinstance(base, ExtendedSystem)
    return ExtendedSystem(ElasticDrive(base), ("elastic",), values)


def test_a_motor_with_a_share_behind_its_drive_is_a_motor_with_a_belt(motor):
    # The package's other example has the same machine with two joints: 3/4 of 2e-4 kg m2 is the load of 1.5e-4 kg m2.
    belt = load_system(f"{EXAMPLES}/motor.py:BeltMotor")
    omega = 2.0 * math.pi * HERTZ
    values = belt.default_parameters() | {
        "stiffness": torch.tensor(omega**2 * 1.5e-4, dtype=torch.float64),
        "belt_damping": torch.tensor(2.0 * RATIO * omega * 1.5e-4, dtype=torch.float64),
        "viscous": torch.tensor(0.0, dtype=torch.float64),
    }
    own = motor.default_parameters() | {"viscous": values["viscous"]}
    front, behind = belt.accelerations(values)(Motion(numbers(0.1, 0.4), numbers(3.0, 2.5), numbers(5.0)))
    joint, stretch = motor.accelerations(own)(Motion(numbers(0.1, 0.3), numbers(3.0, -0.5), numbers(5.0)))
    assert float(joint) == pytest.approx(float(front), rel=1e-12)
    assert float(joint + stretch) == pytest.approx(float(behind), rel=1e-12)


def test_without_a_share_the_system_is_as_given(motor):
    base = motor.base.base
    none = motor.default_parameters() | {"elastic.share": torch.tensor(0.0, dtype=torch.float64)}
    joint, _ = motor.accelerations(none)(Motion(numbers(0.1, 0.3), numbers(3.0, -0.5), numbers(5.0)))
    (wanted,) = base.accelerations(base.default_parameters())(
        Motion(numbers(0.1), numbers(3.0), numbers(5.0))
    )
    assert float(joint) == float(wanted)
    assert effects_of(motor.base).keys() == effects_of(base).keys() | {"elastic"}


def test_the_other_joints_feel_the_lighter_one():
    """A cart whose belt gives: the pole answers to the cart's own acceleration, whatever makes that."""
    base = load_system(f"{EXAMPLES}/cart_pole.py:CartPole")
    names = {"share": SHARE, "frequency": HERTZ, "damping": RATIO}
    cart = ExtendedSystem(
        ElasticDrive(base), ("elastic(cart)",), {f"elastic(cart).{n}": v for n, v in names.items()}
    )
    p = {n: float(v) for n, v in base.default_parameters().items()}
    angle, speed, swing, force, stretch, rate = 0.7, 0.4, -1.1, 3.0, 0.01, -0.2
    found = cart.accelerations(cart.default_parameters())(
        Motion(numbers(0.0, angle, stretch), numbers(speed, swing, rate), numbers(force))
    )
    # M q'' = load by hand. The share is taken off the inertia that a force on the cart moves: M + m sin^2.
    sine, cosine, ml = math.sin(angle), math.cos(angle), p["pole_mass"] * p["length"]
    behind = SHARE * (p["cart_mass"] + p["pole_mass"] * sine**2)
    omega = 2.0 * math.pi * HERTZ
    pull = omega**2 * stretch + 2.0 * RATIO * omega * rate
    on_cart = force - p["cart_viscous"] * speed + ml * swing**2 * sine + behind * pull
    on_pole = -ml * 9.81 * sine - p["pole_viscous"] * swing
    m11, m12, m22 = p["cart_mass"] + p["pole_mass"] - behind, ml * cosine, ml * p["length"]
    determinant = m11 * m22 - m12**2
    x = (m22 * on_cart - m12 * on_pole) / determinant
    a = (m11 * on_pole - m12 * on_cart) / determinant
    assert [float(v) for v in found] == pytest.approx([x, a, -pull - x], rel=1e-10)
    rows = cart.inverse_inertia(cart.default_parameters())(
        Motion(numbers(0.0, angle, stretch), numbers(speed, swing, rate), numbers(force))
    )
    wanted = [m22 / determinant, -m12 / determinant, 0.0, -m12 / determinant, m11 / determinant, 0.0]
    assert [float(v) for row in rows[:2] for v in row] == pytest.approx(wanted, rel=1e-9)


def test_a_model_file_keeps_the_drive(motor, tmp_path):
    save_model(tmp_path / "model.yaml", motor)
    again = load_model(tmp_path / "model.yaml")
    assert again.state_names == motor.state_names
    state = torch.tensor([0.1, 0.3, 3.0, -0.5], dtype=torch.float64)
    effort = torch.tensor(5.0, dtype=torch.float64)
    first, second = (s.derivative(state, effort, s.default_parameters()) for s in (motor, again))
    assert torch.equal(first, second)
    assert again.measured_states == (0,)
