"""The offset of two clocks: bounds that hold whatever the delays are, and a correction that never jumps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.graph.net.clock_offset import (
    ClockJumpError,
    Exchange,
    Offset,
    OffsetEstimator,
    SteadyCorrection,
)
from deepkoco.graph.net.wire import WireError

MS = 1_000_000
delays = st.integers(0, 50 * MS)


def exchange(at: int, there: int, back: int, offset, busy: int = 0) -> Exchange:
    """An exchange that begins at an own time; `offset` tells how far the other clock is ahead then [ns]."""
    arrived, left = at + there, at + there + busy
    return Exchange(at, arrived + offset(arrived), left + offset(left), left + back)


def test_an_answer_from_before_its_question_is_refused_and_leaves_what_is_known():
    offsets = OffsetEstimator(drift=0.0)
    known = offsets.add(Exchange(100, 1030, 1040, 130))
    # The other end claims 40 between question and answer, of which 30 have passed here.
    with pytest.raises(WireError, match="less than no time"):
        offsets.add(Exchange(200, 1130, 1170, 230))
    assert offsets.estimate == known


def test_one_exchange_gives_the_middle_and_half_of_the_round_trip():
    # Asked at 100, the other clock shows 1030 and 1040, the answer is there at 130. The round trip is
    # 30 - 10 = 20, the offset (930 + 910) / 2 = 920, and it is off by 10 at most.
    estimate = OffsetEstimator(drift=0.0).add(Exchange(100, 1030, 1040, 130))
    assert estimate == Offset(920, 10, 20)


def test_the_fastest_ways_there_and_back_decide_wherever_they_come_from():
    estimator = OffsetEstimator(drift=0.0)
    estimator.add(exchange(0, 2 * MS, 9 * MS, lambda _: 0))  # -9 ms <= offset <= 2 ms
    estimate = estimator.add(exchange(100 * MS, 8 * MS, 1 * MS, lambda _: 0))  # -1 ms <= offset <= 8 ms
    assert (estimate.value, estimate.uncertainty) == (MS // 2, 3 * MS // 2)


@given(st.lists(st.tuples(delays, delays, delays), min_size=1, max_size=40), st.integers(-(10**15), 10**15),
       st.floats(-9e-5, 9e-5))  # fmt: skip
def test_the_true_offset_is_within_the_uncertainty_for_any_delays_and_drift(ways, start, drift):
    estimator, at = OffsetEstimator(), 0

    def offset(time: int) -> int:
        return start + round(drift * time)

    for there, back, busy in ways:
        one = exchange(at, there, back, offset, busy)
        estimate = estimator.add(one)
        # Half a nanosecond is rounded away at each of four places.
        assert abs(estimate.value - offset(one.received)) <= estimate.uncertainty + 2
        at = one.received + 20 * MS


def test_a_slow_network_does_no_harm_after_a_fast_answer():
    rng, estimator = np.random.default_rng(0), OffsetEstimator()
    for k in range(200):
        # Ways of 0.05 ms and more, one of them often some milliseconds longer than the other.
        there, back = (round((0.05 + rng.exponential(2.0)) * MS) for _ in range(2))
        if k % 10 == 0:
            there = back = round(0.05 * MS)
        estimate = estimator.add(
            exchange(k * 20 * MS, there, back, lambda time: 5 * 10**12 + round(4e-5 * time))
        )
    truth = 5 * 10**12 + round(4e-5 * 199 * 20 * MS)
    assert abs(estimate.value - truth) < 0.1 * MS
    assert estimate.uncertainty < 0.2 * MS


def test_a_clock_that_jumps_is_noticed_and_then_known():
    estimator = OffsetEstimator()
    for k in range(20):
        estimator.add(exchange(k * 20 * MS, MS // 10, MS // 10, lambda _: 0))
    with pytest.raises(ClockJumpError, match=r"the clocks of the two machines are 29\.\d ms further apart"):
        estimator.add(exchange(500 * MS, MS // 10, MS // 10, lambda _: 30 * MS))
    estimate = estimator.add(exchange(520 * MS, MS // 10, MS // 10, lambda _: 30 * MS))
    assert estimate.value == 30 * MS


def test_a_clock_that_is_bent_for_a_while_is_no_jump():
    estimator = OffsetEstimator()
    for k in range(20):
        estimator.add(exchange(k * 20 * MS, MS // 10, MS // 10, lambda _: 0))
    estimate = estimator.add(exchange(400 * MS, MS // 10, MS // 10, lambda _: MS // 2))
    assert estimate.value == MS // 2


def test_the_correction_follows_without_a_jump_and_arrives():
    cell = np.zeros(1, np.int64)
    clock = SteadyCorrection(cell)
    clock.set(Offset(7 * 10**15, 0, 0), 0)
    assert clock.value == 7 * 10**15
    previous, target = clock.value, clock.value + MS
    for k in range(1, 500):
        clock.follow(Offset(target, 0, 0), k * 20 * MS)
        # 0.0005 s per second: 10 us in 20 ms.
        assert 0 <= clock.value - previous <= 10_000
        previous = clock.value
    assert abs(clock.value - target) < 10
