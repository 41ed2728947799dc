"""Which command acts when, against a slow reading of the rule."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.agent.sent_commands import SentCommands

FIRST = np.array([-1.0])


def sent(arrivals):
    """Commands 0, 1, 2, ... sent at these times, with these arrivals."""
    commands = SentCommands()
    commands.start(FIRST)
    for number, arrival in enumerate(arrivals):
        commands.send(np.array([float(number)]), float(number), arrival)
    return commands


def acting(arrivals, time):
    """The newest command that has arrived by a time."""
    there = [number for number, arrival in enumerate(arrivals) if arrival <= time]
    return float(max(there)) if there else -1.0


@settings(max_examples=200, deadline=None)
@given(delays=st.lists(st.floats(0.0, 12.0), max_size=14), span=st.tuples(st.floats(0, 20), st.floats(0, 20)))
def test_the_newest_command_that_has_arrived_acts_whatever_the_order(delays, span):
    arrivals = [number + delay for number, delay in enumerate(delays)]
    begin, end = sorted(span)
    times, actions = sent(arrivals).between(begin, end)
    assert (np.diff(times) > 0).all()
    assert ((times > begin) & (times <= end)).all()
    assert actions[0, 0] == acting(arrivals, begin)
    for time, action in zip(times, actions[1:, 0], strict=True):
        assert action == acting(arrivals, time)
    changes = sorted({acting(arrivals, t) for t in [begin, *(a for a in arrivals if begin < a <= end)]})
    assert actions[:, 0].tolist() == changes


def test_an_overtaken_command_never_acts():
    times, actions = sent([0.5, 5.0, 3.0]).between(0.0, 10.0)
    assert times.tolist() == [0.5, 3.0]
    assert actions[:, 0].tolist() == [-1.0, 0.0, 2.0]


def test_known_delays_replace_the_expected_and_what_is_late_is_expected_now():
    commands = sent([0.2, 1.2, 2.2])
    commands.measure([math.inf, 0.5, math.inf], now=3.0)  # newest first
    times, actions = commands.between(0.0, 9.0)
    assert times.tolist() == [1.5, 3.0]
    assert actions[:, 0].tolist() == [-1.0, 1.0, 2.0]
