"""Plug flow: nothing gets lost, what leaves is what entered, and the delay is that of the characteristic."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from deepkoco.systems.fluids import fill_pipe, outlet_value, pipe_content, push_fluid, swept_time

VOLUME = 2.0
inflows = st.lists(
    st.one_of(st.just(0.0), st.floats(1e-6, 0.02), st.floats(0.0, 0.5), st.floats(0.0, 5.0)),
    min_size=1,
    max_size=40,
)


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def run(inflow, values, cells: int, volume=VOLUME, start: float = 0.0):
    """Push one after the other through one pipe; values at the outlet, contents that left, and the fluid at last."""
    fluid, means, contents = fill_pipe(tensor(start)[:, None], tensor(volume)[0], cells), [], []
    for pushed, value in zip(inflow, values, strict=True):
        fluid, left = push_fluid(fluid, tensor(pushed), tensor(value)[:, None], tensor(volume)[0], cells)
        means.append(float(left.mean))
        contents.append(float(left.content))
    return np.array(means), np.array(contents), fluid


def exact_means(inflow, values, volume=VOLUME, start: float = 0.0):
    """Means over the swept volume of a signal that is constant over each push, by numpy's interpolation."""
    inflow, values = np.array(inflow), np.array(values)
    swept = np.concatenate([[0.0], np.cumsum(inflow)])
    content = np.concatenate([[0.0], np.cumsum(inflow * values)])

    def until(s):
        return np.where(s < 0.0, start * s, np.interp(s, swept, content))

    return np.diff(until(swept - volume))


@settings(max_examples=60, deadline=None)
@given(inflow=inflows, cells=st.integers(2, 12), seed=st.integers(0, 99))
def test_what_went_in_less_what_came_out_is_what_the_pipe_holds_more(inflow, cells, seed):
    values = np.random.default_rng(seed).normal(20.0, 5.0, len(inflow))
    _, contents, fluid = run(inflow, values, cells, start=18.0)
    more = float(pipe_content(fluid)) - 18.0 * VOLUME
    assert more == pytest.approx(np.dot(inflow, values) - contents.sum(), abs=1e-9)
    assert float(fluid.edges[0, -1]) == VOLUME
    assert (fluid.edges.diff() >= 0).all()


@settings(max_examples=60, deadline=None)
@given(inflow=st.lists(st.floats(0.101, 3.0), min_size=1, max_size=40), seed=st.integers(0, 99))
def test_pushes_above_the_resolution_come_out_exactly(inflow, seed):
    values = np.random.default_rng(seed).normal(20.0, 5.0, len(inflow))
    _, contents, _ = run(inflow, values, 20, start=18.0)
    np.testing.assert_allclose(contents, exact_means(inflow, values, start=18.0), atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(inflow=inflows, seed=st.integers(0, 99))
def test_below_the_resolution_a_step_comes_at_most_a_cell_early_or_late(inflow, seed):
    """A step from 0 to 1 after some pushes: before and after it, by more than a cell, the outlet is 0 or 1."""
    step = int(np.random.default_rng(seed).integers(len(inflow) + 1))
    cells = 10
    means, _, _ = run(inflow, [float(k >= step) for k in range(len(inflow))], cells)
    swept = np.concatenate([[0.0], np.cumsum(inflow)]) - VOLUME - sum(inflow[:step])  # since the step came
    cell = VOLUME / cells + 1e-9
    np.testing.assert_allclose(means[swept[1:] <= -cell], 0.0, atol=1e-12)
    np.testing.assert_allclose(means[swept[:-1] >= cell], 1.0, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(inflow=inflows, cells=st.integers(2, 12), seed=st.integers(0, 99))
def test_the_outlet_is_never_beyond_what_went_in(inflow, cells, seed):
    values = np.random.default_rng(seed).uniform(-1.0, 3.0, len(inflow))
    means, _, fluid = run(inflow, values, cells)
    low, high = min(0.0, values.min()) - 1e-9, max(0.0, values.max()) + 1e-9
    assert ((means >= low) & (means <= high)).all()
    assert low <= float(outlet_value(fluid)) <= high


def test_a_constant_flow_is_a_delay_of_volume_by_flow():
    """0.25 m3 a push through 2 m3: eight pushes late, to the last bit."""
    values = np.random.default_rng(0).normal(size=30)
    means, _, _ = run([0.25] * 30, values, 20)
    np.testing.assert_array_equal(means[8:], values[:-8])
    assert (means[:8] == 0.0).all()


@pytest.mark.parametrize("inflow", [1e-300, 1e-17, 3e-16, 1e-12])
def test_a_push_that_rounding_takes_away_shows_what_is_at_the_outlet(inflow):
    means, _, _ = run([0.7, 0.9, inflow, 0.7], [1.0, 2.0, 3.0, 4.0], 10, start=5.0)
    np.testing.assert_allclose(means[:3], 5.0, rtol=1e-12)


def test_a_pipe_that_stands_still_keeps_what_it_has():
    means, _, fluid = run([0.5, 0.5, 0.0, 0.0, 0.5, 0.5, 0.5], [1.0, 2.0, 9.0, 9.0, 3.0, 4.0, 5.0], 10)
    # 2 m3 hold four pushes of 0.5: the first comes out with the fifth that moves.
    np.testing.assert_allclose(means, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert float(outlet_value(fluid)) == 2.0


def test_each_pipe_of_a_batch_has_its_own_volume():
    volume = tensor(1.0, 2.0)
    fluid = fill_pipe(torch.zeros(2, 1, dtype=torch.float64), volume, 10)
    seen = []
    for k in range(6):
        fluid, left = push_fluid(
            fluid, tensor(0.5, 0.5), torch.full((2, 1), k + 1.0, dtype=torch.float64), volume, 10
        )
        seen.append(left.mean[:, 0].tolist())
    assert [row[0] for row in seen] == [0, 0, 1, 2, 3, 4]
    assert [row[1] for row in seen] == [0, 0, 0, 0, 1, 2]


def test_a_varying_flow_has_the_delay_of_the_characteristic():
    """Oracle: scipy runs the fluid at the outlet back to the inlet. What is transported is the time of entry."""
    dt, steps = 0.1, 200
    time = dt * np.arange(steps)
    flow = np.where(time % 4.0 < 2.0, 1.1, 0.35)
    for k in (60, 117, 199):
        _, _, fluid = run(flow[: k + 1] * dt, time[: k + 1] + 0.5 * dt, 60)
        now = dt * (k + 1)
        back = solve_ivp(_back_from(now), (0.0, 20.0), [0.0], events=_swept, max_step=0.01)
        assert now - float(outlet_value(fluid)) == pytest.approx(back.t_events[0][0], abs=0.5 * dt + 0.01)
        past = torch.tensor(flow[k::-1].copy() * dt, dtype=torch.float64)[None]
        assert float(swept_time(past, dt, tensor(VOLUME)[0])) == pytest.approx(back.t_events[0][0], abs=0.01)


def _back_from(now: float):
    """The flow a time s before now."""
    return lambda s, gone: [np.where((now - s - 1e-12) % 4.0 < 2.0, 1.1, 0.35)]


def _swept(_, gone):
    return gone[0] - VOLUME


_swept.terminal = True  # type: ignore[attr-defined]


@settings(max_examples=30, deadline=None)
@given(flow=st.lists(st.floats(0.05, 2.0), min_size=3, max_size=12), volume=st.floats(0.1, 3.0))
def test_the_swept_time_is_the_bound_of_the_integral(flow, volume):
    volumes = tensor(*flow)[None]  # a second each, newest first
    back = float(swept_time(volumes, 1.0, tensor(volume)[0]))
    if sum(flow) < volume:
        assert back == len(flow)
        return
    swept = quad(
        lambda s: flow[min(int(s), len(flow) - 1)], 0.0, back, points=list(range(1, len(flow))), limit=200
    )[0]
    assert swept == pytest.approx(volume, abs=1e-6)


def test_it_has_the_gradients_of_finite_differences():
    values = torch.linspace(0.1, 0.7, 12, dtype=torch.float64)
    inflow = torch.linspace(0.3, 0.6, 12, dtype=torch.float64)

    def leaves(volume, inflow, values):
        fluid = fill_pipe(torch.zeros(1, 1, dtype=torch.float64), volume, 10)
        means = []
        for k in range(12):
            fluid, left = push_fluid(fluid, inflow[k : k + 1], values[k : k + 1, None], volume, 10)
            means.append(left.mean[0, 0])
        return torch.stack(means)

    arguments = tensor(1.9)[0].requires_grad_(), inflow.requires_grad_(), values.requires_grad_()
    assert torch.autograd.gradcheck(leaves, arguments)
