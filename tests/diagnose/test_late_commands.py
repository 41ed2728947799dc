"""A common delay of all commands, searched for where the sizes of the joints lead to no log."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.evidence.far_parameters import far_names
from deepkoco.diagnose.late_commands import common_delay, sizes_when_late, with_delay_free
from deepkoco.diagnose.tempered import sizes_of_joints
from deepkoco.fit import FitProblem, cut_windows
from deepkoco.fit.solve.scale_search import cost_of, search_scales
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem, make_system
from tests.fit.test_scale_search import ARM, STIFF, stiff
from tests.systems.trees.random_trees import mujoco_log

__all__ = ["stiff"]
RATE, LATE = 50.0, 0.16  # [Hz, s]
DELAY = "actuation_delay(all).delay"


@pytest.fixture(scope="module")
def late(stiff):
    """Windows of the stiff arm as it is given, whose goals act late: they wander, so that no start is at rest."""
    system, _, _ = stiff
    rng = np.random.default_rng(11)
    goals = np.cumsum(rng.normal(0.0, 0.03, (300, 2)), axis=0)
    behind = np.concatenate([np.repeat(goals[:1], round(LATE * RATE), 0), goals])[: len(goals)]
    log = mujoco_log(mujoco.MjModel.from_xml_string(ARM.format(**STIFF)), system, behind, RATE, rng)
    names = [c.name for c in system.commands]
    sent = {n: replace(log.channels[n], value=goals[:, k]) for k, n in enumerate(names)}
    windows = cut_windows([Recording(log.channels | sent)], system, 1.0)
    start = baseline_from(system, windows)
    return start, FitProblem(start.system, windows)


def test_the_delay_of_all_commands_is_one_parameter_of_the_robot(stiff):
    system, soft, _ = stiff
    assert common_delay(baseline_from(system, soft).system) == DELAY
    assert common_delay(ExtendedSystem(make_system("pendulum"))) == "actuation_delay.delay"


def test_sizes_of_a_late_arm_are_found_under_its_delay(late):
    start, problem = late
    sizes = sizes_of_joints(start)
    state, _ = problem.fit_states(start.values, problem.windows.state)
    values, left = sizes_when_late(problem, sizes, start.values, state, DELAY)
    alone, without = search_scales(problem, sizes, start.values, state)
    assert 0.08 <= values[DELAY] <= 0.25
    assert alone[DELAY] == 0.0
    assert left < 0.5 * without
    assert left == pytest.approx(cost_of(problem, values, state) / cost_of(problem, start.values, state))


def test_a_baseline_that_frees_the_delay_simulates_it_from_zero(late):
    start, _ = late
    free = with_delay_free(start, DELAY)
    assert free.prior.names == (*start.prior.names, DELAY)
    assert free.prior.centre[-1] == 0.0
    assert free.effects == ("actuation_delay(all)",)


def test_a_delay_is_far_where_its_interval_excludes_none(late):
    start, _ = late
    free = with_delay_free(start, DELAY)
    fit: Any = SimpleNamespace(
        values={**start.values, DELAY: 0.04}, free=(DELAY,), covariance=np.diag([0.01**2])
    )
    assert far_names(free, fit, 1.0) == [DELAY]
    assert far_names(free, fit, 9.0) == []
    assert far_names(start, fit, 1.0) == []
