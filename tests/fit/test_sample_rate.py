"""Simulations follow what the fastest measured channel of any log shows."""

import numpy as np
import pytest

from deepkoco.fit.data.sample_rate import sampled_as
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems.bodies.two_link_arm import TwoLinkArm


class Asked(TwoLinkArm):
    """An arm that tells the interval and the jumps of commands for which it was asked."""

    def sampled_every(self, interval, jumps=None):
        self.jumps = jumps
        return interval


def log(**stamps):
    series = {
        n: Series(np.asarray(t, dtype=float), np.zeros(len(t)), "rad", "measurement")
        for n, t in stamps.items()
    }
    return Recording(series)


def test_the_fastest_measured_channel_of_any_log_decides():
    first, second, *_ = [c.name for c in TwoLinkArm().measurements]
    slow, fast = (
        log(**{first: np.arange(50) * 0.09}),
        log(**{first: np.arange(50) * 0.1, second: np.arange(50) * 0.02}),
    )
    assert sampled_as(Asked(), [slow, fast]) == pytest.approx(0.02)


def test_commands_and_other_topics_do_not_count():
    first, *_ = [c.name for c in TwoLinkArm().measurements]
    given = log(**{first: np.arange(50) * 0.09, "camera": np.arange(50) * 0.001})
    assert sampled_as(Asked(), [given]) == pytest.approx(0.09)


def test_the_largest_jump_of_each_command_in_any_log_is_told():
    (first, *_), (command, *_) = (
        [c.name for c in cs] for cs in (TwoLinkArm().measurements, TwoLinkArm().commands)
    )
    logs = [log(**{first: np.arange(4) * 0.09, command: np.arange(4) * 0.09}) for _ in range(2)]
    logs[0].channels[command].value[:] = [0.0, 0.2, 0.1, np.nan]
    logs[1].channels[command].value[:] = [1.0, 1.0, 0.5, 0.5]
    arm = Asked()
    sampled_as(arm, logs)
    assert arm.jumps == {command: pytest.approx(0.5)}


def test_samples_that_come_in_pairs_show_what_is_as_fast_as_these():
    first, *_ = [c.name for c in TwoLinkArm().measurements]
    pairs = np.sort(np.concatenate([np.arange(40) * 0.1, np.arange(40) * 0.1 + 0.004]))
    assert sampled_as(Asked(), [log(**{first: pairs})]) == pytest.approx(0.004)


def test_without_two_samples_the_system_stays():
    arm = Asked()
    assert sampled_as(arm, [log(**{arm.measurements[0].name: [0.0]})]) is arm
