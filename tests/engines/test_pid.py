"""The PID node: its law by hand, its limits, its settings by environment."""

import numpy as np
import pytest
import torch

from deepkoco.engines.pid import Pid
from deepkoco.graph import Input


def given(*values: float) -> Input:
    data = torch.tensor(values, dtype=torch.float64)[:, None, None]
    return Input(data, *(torch.zeros(len(values), 1),) * 3, torch.zeros(len(values)))


def steps(pid: Pid, goals, measured, parameters=None, dt: float = 0.5) -> list[float]:
    state, commands = pid.init({}, torch.Generator(), 1), []
    for goal, seen in zip(goals, measured, strict=True):
        state, command = pid.step(
            parameters or {}, state, {"goal": given(goal), "measured": given(seen)}, dt=dt
        )
        commands.append(float(command))
    return commands


def test_proportional_and_integral_action_by_hand():
    """K = 2, T_i = 4, dt = 0.5, error 1: 2, then the integral grows by 2 / 4 * 0.5 = 0.25 a step."""
    pid = Pid("pid", 2.0, 2.0, 4.0, low=-10.0, high=10.0, bias=0.5)
    assert steps(pid, [1.0] * 4, [0.0] * 4) == pytest.approx([2.5, 2.75, 3.0, 3.25])


def test_derivative_action_is_on_the_measurement_alone():
    pid = Pid("pid", 2.0, 1.0, 1e9, 8.0, low=-99.0, high=99.0)
    # T_d / 8 = 1 s, dt = 0.5: the filter takes a third of each step. A step of the goal alone makes no kick.
    assert steps(pid, [0.0, 1.0], [0.0, 0.0]) == pytest.approx([0.0, 1.0])
    # y from 0 to 3: slope 1/3 * 3 / 0.5 = 2, D = -16, P = -3; then the rest 2 of the step: slope 4/3.
    assert steps(pid, [0.0] * 3, [0.0, 3.0, 3.0]) == pytest.approx([0.0, -19.0, -3.0 - 32.0 / 3.0], abs=1e-6)


def test_it_does_not_wind_up_at_a_limit():
    """A second after an error of an hour changes sign, the command has left the limit; without tracking it has not."""
    goals, measured = [1.0] * 7200 + [-1.0] * 2, [0.0] * 7202
    tracking = Pid("pid", 2.0, 2.0, 4.0, low=0.0, high=1.0)
    winding = Pid("pid", 2.0, 2.0, 4.0, low=0.0, high=1.0, tracking_time=1e12)
    assert steps(tracking, goals, measured)[-1] < 0.5
    assert steps(winding, goals, measured)[-1] == 1.0


def test_commands_stay_within_their_limits_and_reach_them():
    commands = steps(Pid("pid", 2.0, 50.0, 4.0, low=0.2, high=0.7), np.sin(np.arange(50.0)), [0.0] * 50)
    assert min(commands) == 0.2
    assert max(commands) == 0.7


def test_each_environment_can_have_settings_of_its_own():
    pid = Pid("pid", 2.0, 2.0, 4.0, low=-10.0, high=10.0)
    state = pid.init({}, torch.Generator(), 2)
    own = {"gain": torch.tensor([1.0, 3.0], dtype=torch.float64)}
    _, command = pid.step(own, state, {"goal": given(1.0, 1.0), "measured": given(0.0, 0.0)}, dt=0.5)
    assert command[:, 0].tolist() == [1.0, 3.0]


@pytest.mark.parametrize(
    "wrong", [{"integral_time": 0.0}, {"gain": float("nan")}, {"derivative_time": -1.0}, {"low": 2.0}]
)
def test_settings_that_are_no_controller_are_refused(wrong):
    settings = {"gain": 1.0, "integral_time": 10.0, "low": 0.0, "high": 1.0, **wrong}
    with pytest.raises(ValueError, match="give"):
        Pid("pid", 1.0, **settings)
