"""The pool: no heat gets lost in the pipe, and its equations are those of a delayed exchange."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from deepkoco.systems.fluids import pool_energy, pool_parameters, pool_tick, start_pool
from deepkoco.systems.fluids.pool import HEAT_CAPACITY, at_outlet


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def world(**changed: float) -> dict[str, torch.Tensor]:
    return pool_parameters()["world"] | {name: tensor(value)[0] for name, value in changed.items()}


@settings(max_examples=60, deadline=None)
@given(
    flow=st.lists(
        st.one_of(st.just(0.0), st.floats(0.0, 2e-3), st.floats(0.0, 0.1)), min_size=1, max_size=60
    ),
    power=st.floats(-2e4, 4e4),
)
def test_without_a_loss_the_water_gains_what_the_heater_gives(flow, power):
    """Also where the pipe turns over within a tick, and where it stands still."""
    own = world(heat_loss=0.0)
    state = start_pool(tensor(30.0), own)
    before = float(pool_energy(state, own))
    for k, q in enumerate(flow):
        state, _ = pool_tick(state, tensor(power), tensor(q), tensor(float(k)), 1.0, own)
    assert float(pool_energy(state, own)) - before == pytest.approx(power * len(flow), abs=1e-3)  # of 4e8 J


def test_without_flow_the_pool_is_an_exponential():
    """T' = (P - U (T - T_air)) / (rho c W): to T_air + P / U with the time constant rho c W / U."""
    own = world(heat_loss=2000.0)
    state = start_pool(tensor(30.0), own)
    for k in range(100):
        state, _ = pool_tick(state, tensor(1e4), tensor(0.0), tensor(float(k)), 10.0, own)
    rate = 2000.0 / (HEAT_CAPACITY * 3.0)
    assert float(state.temperature) == pytest.approx(23.0 + 7.0 * np.exp(-1000.0 * rate), abs=1e-9)


def test_with_a_constant_flow_it_is_the_delay_equation_of_its_docstring():
    """Oracle: scipy, one delay after the other (the method of steps), in a pipe that holds 10 % of the pool."""
    own = world(pool_volume=0.6, pipe_volume=0.06)
    flow, heat, delay = 1e-3, 2e4, 60.0
    state = start_pool(tensor(30.0), own)
    seen = [30.0]
    for k in range(600):
        state, _ = pool_tick(state, tensor(heat), tensor(flow), tensor(0.5 * k), 0.5, own)
        seen.append(float(state.temperature))
    capacity = HEAT_CAPACITY * 0.6
    pieces = []

    def out(t):
        return 30.0 if t <= delay else pieces[int((t - delay) // delay)].sol(t - delay)[0]

    def slope(t, y):
        through = flow * HEAT_CAPACITY * (out(t) - y[0])
        return [(heat + through - 250.0 * (y[0] - 18.0)) / capacity]

    start = 30.0
    for part in range(5):
        span = (part * delay, (part + 1) * delay - 1e-9)
        pieces.append(solve_ivp(slope, span, [start], dense_output=True, rtol=1e-10, atol=1e-10))
        start = pieces[-1].y[0, -1]
    expected = [30.0] + [pieces[min(int((t - 1e-6) // delay), 4)].sol(t)[0] for t in 0.5 * np.arange(1, 601)]
    np.testing.assert_allclose(seen, expected, atol=2e-4)


def test_what_comes_out_is_as_old_as_the_flow_says():
    """60 l at 1 l/s are 60 s, then at 0.2 l/s: 30 s on, 30 + 6 l have gone, so it is still fluid of 1 l/s."""
    own = world()
    state = start_pool(tensor(30.0), own)
    for k in range(200):
        flow = 1e-3 if k < 120 else 0.2e-3
        state, outlet = pool_tick(state, tensor(0.0), tensor(flow), tensor(float(k)), 1.0, own)
        if k in (119, 149):
            age = k + 0.5 - float(outlet[0, 1])
            # At 119: 60. At 149: 30 ticks moved 6 l, 54 l before 120 entered at 66: 84 s ago. Elements are 1 l.
            assert age == pytest.approx({119: 60.0, 149: 84.0}[k], abs=1.0)
    assert float(at_outlet(state)[0, 1]) < 200.0
