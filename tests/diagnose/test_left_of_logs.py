"""What simulations leave of logs: of a machine, in steps that are short enough for them."""

import pytest

pytest.importorskip("mujoco")

from deepkoco.diagnose.left_of_logs import LeftOfLogs
from tests.oracle.fine_arm import fine_arm, seen


def test_steps_that_are_too_long_are_not_left_of_a_machine(tmp_path):
    # An engine has shorter steps of its own: 5.1 noise variances of long steps would speak for any of them.
    system, windows = fine_arm(tmp_path)
    assert LeftOfLogs(seen(windows, 3e-5))(system.base).per_sample < 1.2
