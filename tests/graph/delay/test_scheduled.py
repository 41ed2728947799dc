"""Delays that are a function of time: drawn beforehand, also those of a pipe whose flow is known."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from deepkoco.graph import Connection, DelayError, Graph, Supervisor, draw_timing, make_delay
from deepkoco.graph.delay import Scheduled, transport_delay
from deepkoco.graph.live import ConcurrentRuntime
from tests.graph.timing_reference import Accumulate

RAMP = Scheduled((0.0, 1.0, 1.0, 2.0), (0.1, 0.3, 0.05, 0.05))


def loop(delay, phase: float = 0.25) -> Graph:
    action = torch.zeros(1, dtype=torch.float64)
    return Graph(
        [Accumulate("sensor", 10.0, 0.02, phase=phase), Supervisor("agent", 10.0, initial_action=action)],
        [Connection("sensor", "agent", delay, fifo=False), Connection("agent", "sensor", skip=True)],
    )


def test_it_is_linear_between_its_points_and_jumps_where_two_have_one_time():
    # Before 0: 0.1. At 0.5: half way from 0.1 to 0.3. At 1 the delay after the jump. From 2 on 0.05.
    np.testing.assert_allclose(RAMP.at([-1.0, 0.0, 0.5, 1.0, 1.5, 9.0]), [0.1, 0.1, 0.2, 0.05, 0.05, 0.05])


def test_mean_and_distribution_are_those_of_a_random_time():
    # Half of the time from 0.1 to 0.3, half of it 0.05: mean (0.2 + 0.05) / 2.
    assert RAMP.mean == pytest.approx(0.125)
    np.testing.assert_allclose(RAMP.cdf(np.array([0.04, 0.05, 0.2, 0.3])), [0.0, 0.5, 0.75, 1.0])
    draws = RAMP.sample(np.random.default_rng(0), (20_000,))
    assert draws.mean() == pytest.approx(RAMP.mean, abs=0.003)
    assert (draws <= 0.2).mean() == pytest.approx(0.75, abs=0.01)


def test_a_description_makes_the_law():
    assert make_delay(RAMP.to_dict()) == RAMP


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"times": [0.0, 1.0], "delays": [0.1]}, "2 times and 1 delays"),
        ({"times": [1.0, 0.0], "delays": [0.1, 0.1]}, "must not decrease"),
        ({"times": [0.0], "delays": [-0.1]}, "is no delay"),
        ({"times": [], "delays": []}, "0 times"),
    ],
)
def test_what_is_no_table_is_refused(wrong, message):
    with pytest.raises(DelayError, match=message):
        make_delay({"law": "scheduled", **wrong})


@pytest.mark.parametrize("law", ["mixture", "autoregressive"])
def test_laws_that_know_no_time_refuse_it(law):
    options = {
        "mixture": {"components": [RAMP], "weights": [1]},
        "autoregressive": {"delay": RAMP, "correlation": 0.5},
    }
    with pytest.raises(DelayError, match="depends on the time"):
        make_delay({"law": law, **options[law]})


def test_each_message_has_the_delay_of_its_nominal_time():
    timing = draw_timing(loop(RAMP), np.random.default_rng(0), 30, 2)
    for row in range(2):
        sent, received = (times[:20] / timing.resolution for times in timing.messages_of(0, row))
        # Sent at the phase 0.25 s, after a computation of 20 ms, every 0.1 s.
        nominal = 0.27 + 0.1 * np.arange(20)
        np.testing.assert_allclose(sent, nominal, atol=1e-9)
        np.testing.assert_allclose(received - sent, RAMP.at(nominal), atol=2e-9)


def test_the_delays_do_not_depend_on_how_long_the_timing_is():
    short, long = (draw_timing(loop(RAMP), np.random.default_rng(0), steps, 1) for steps in (5, 300))
    for one, other in zip(short.messages_of(0, 0), long.messages_of(0, 0), strict=True):
        np.testing.assert_array_equal(one[:5], other[:5])


def test_a_run_by_the_clock_simulates_it():
    with ConcurrentRuntime(loop(RAMP), sync=False, real_time_factor=5.0) as runtime:
        runtime.reset({}, torch.Generator().manual_seed(0))
        runtime.run(lambda inputs: torch.zeros(1, 1, dtype=torch.float64), 15)
        episode = runtime.finish()
    sent, received = episode.t_sent["sensor->agent"], episode.t_received["sensor->agent"]
    assert len(sent) >= 10
    # The delay is that of the nominal time of sending, however late the step was.
    nominal = 0.27 + 0.1 * np.arange(len(sent))
    np.testing.assert_allclose(received - sent, RAMP.at(nominal), atol=1e-6)


def test_a_constant_flow_has_the_delay_volume_by_flow():
    law = transport_delay([0.0, 5.0], [0.5, 0.5], 2.0)
    np.testing.assert_allclose(law.at([0.0, 3.3, 100.0]), 4.0)


def test_what_enters_a_pipe_waits_while_it_stands_still():
    """1 m3/s, none from 4 s to 10 s, then 1 m3/s again, through 2 m3."""
    law = transport_delay([0.0, 4.0, 10.0], [1.0, 0.0, 1.0], 2.0)
    # At 1: leaves at 3. At 3: 1 m3 by 4 s, the other by 11. At 6: nothing moves, leaves at 12. At 11: 13.
    np.testing.assert_allclose(law.at([1.0, 3.0, 6.0, 11.0]), [2.0, 8.0, 6.0, 2.0])
    # What entered just before 2 leaves before the standstill, just after 2 only with its end.
    np.testing.assert_allclose(law.at([2.0 - 1e-9, 2.0 + 1e-9]), [2.0, 8.0], atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(
    flow=st.lists(st.floats(0.2, 3.0), min_size=1, max_size=6),
    volume=st.floats(0.1, 10.0),
    enters=st.floats(0.0, 12.0),
)
def test_the_delay_is_that_of_the_characteristic(flow, volume, enters):
    """Oracle: scipy integrates the flow from the inlet on and finds when it has gone through the volume."""
    times = 2.0 * np.arange(len(flow))

    def gone(until):
        bends = [t for t in times if enters < t < until]
        return quad(
            lambda t: flow[np.searchsorted(times, t, side="right") - 1], enters, until, points=bends or None
        )[0]

    leaves = brentq(lambda until: gone(until) - volume, enters, enters + volume / 0.2 + 1.0, xtol=1e-12)
    assert transport_delay(times, flow, volume).at(enters) == pytest.approx(leaves - enters, abs=1e-7)


@pytest.mark.parametrize(
    ("times", "flow", "volume"),
    [([0.0, 1.0], [1.0, 0.0], 1.0), ([0.0], [-1.0], 1.0), ([0.0, 0.0], [1.0, 1.0], 1.0), ([0.0], [1.0], 0.0)],
)
def test_a_pipe_that_fluid_never_leaves_is_refused(times, flow, volume):
    with pytest.raises(DelayError, match="transport_delay"):
        transport_delay(times, flow, volume)
