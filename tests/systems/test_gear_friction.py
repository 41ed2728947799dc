"""Dry friction of a gear: efficiency in both directions, excess at standstill, and agreement with a quadrature."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.systems.gear_friction import GearFriction, gear_friction_of, gear_friction_parameters


def _number(x: float) -> torch.Tensor:
    return torch.tensor(x, dtype=torch.float64)


@given(load=st.floats(0.05, 2.0), share=st.floats(0.0, 0.9))
def test_gear_lifts_with_the_inverse_efficiency_and_lowers_with_the_efficiency(load, share):
    # Half the friction is made at each side: F = mu |t_m - t_e| / 2. Lifting slowly, t_m = load + F and t_e = -load,
    # so t_m - load = mu (t_m + load) / 2, which is t_m = load (1 + mu/2) / (1 - mu/2). Lowering is the inverse of it.
    gear = GearFriction(0.0, share)
    ratio = (1.0 + share / 2.0) / (1.0 - share / 2.0)
    for motor, sign in ((load * ratio, 1.0), (load / ratio, -1.0)):
        friction = gear.level(_number(motor), _number(-load), _number(0.0))
        assert float(friction) == pytest.approx(sign * (motor - load), rel=1e-9, abs=1e-12)


@given(
    motor=st.floats(-2.0, 2.0),
    outside=st.floats(-2.0, 2.0),
    speed=st.floats(-5.0, 5.0),
    side=st.floats(0.0, 1.0),
)
def test_gear_friction_has_no_direction_and_is_never_below_the_dry_one(motor, outside, speed, side):
    gear = GearFriction(0.01, 0.2, 0.5, side, 0.4, 0.3)
    level = gear.level(*map(_number, (motor, outside, speed)))
    mirrored = gear.level(*map(_number, (-motor, -outside, -speed)))
    assert float(level) == pytest.approx(float(mirrored))
    assert float(level) >= 0.01


@given(motor=st.floats(0.0, 20.0), share=st.floats(0.0, 0.9), growth=st.floats(0.0, 5.0))
def test_gear_that_moves_takes_up_less_than_it_transmits(motor, share, growth):
    gear = GearFriction(0.0, share, growth, at_load=0.0)
    assert float(gear.level(_number(motor), _number(0.0), _number(1.0))) <= motor * (1.0 + 1e-12)


def test_share_begins_with_its_growth():
    # 1e-3 N m in the gear: a share of 0.2 + 0.5 * 1e-3, less 1e-3 of 0.5e-3 / 0.8 of what grows.
    gear = GearFriction(0.0, 0.2, 0.5, at_load=0.0)
    expected = 1e-3 * (0.2 + 0.5e-3 / (1.0 + 0.5e-3 / 0.8))
    assert float(gear.level(_number(1e-3), _number(0.0), _number(1.0))) == pytest.approx(expected, rel=1e-9)


def test_excess_at_standstill_falls_to_its_37_percent_at_the_declared_speed():
    gear = GearFriction(0.1, excess=0.5, speed=0.2)
    zero = _number(0.0)
    assert float(gear.level(zero, zero, zero)) == pytest.approx(0.15)
    assert float(gear.level(zero, zero, _number(-0.2))) == pytest.approx(0.1 + 0.05 * 0.36788, rel=1e-5)


def test_nominal_values_are_those_of_the_declarations():
    declared = {p.name: _number(p.value) for p in gear_friction_parameters(0.02, 0.8)}
    level = gear_friction_of(declared).level(_number(0.8), _number(0.0), _number(5.0))
    # Half of 0.8 N m presses the teeth: 0.02 + 0.2 * 0.4.
    assert float(level) == pytest.approx(0.1, rel=1e-6)
