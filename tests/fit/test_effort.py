"""Efforts over integration steps, computed from commands."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.simulate.command_effort import TooManyLagsError, step_efforts
from deepkoco.fit.simulate.held_efforts import HeldEfforts
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.bodies.rod_pendulum import RodPendulum


def windows_of(t, value, t0, step, steps) -> Windows:
    empty = torch.zeros(len(t0), 2, 0, dtype=torch.float64)
    command = CommandSeries(np.array(t, dtype=float), np.array(value, dtype=float))
    state = torch.zeros(len(t0), 2, dtype=torch.float64)
    log = np.zeros(len(t0), dtype=int)
    return Windows((command,), log, np.array(t0), step, steps, empty, empty, empty.bool(), (), state, log > 0)


def efforts(windows, **values):
    system = ExtendedSystem(make_system("rod_pendulum"), tuple({n.split("__")[0] for n in values}))
    named = {n.replace("__", "."): torch.tensor([v], dtype=torch.float64) for n, v in values.items()}
    start, slope = step_efforts(system, windows, system.default_parameters() | named, 1)
    return start[0].numpy(), slope[0].numpy()


def test_command_efforts_equal_held_commands_without_delay():
    windows = windows_of([0.0, 0.5], [1.0, -2.0], [0.1, 0.6], 0.01, 20)
    start, slope = efforts(windows)
    assert start == pytest.approx(np.repeat([[1.0], [-2.0]], 20, axis=1), abs=1e-6)
    assert slope == pytest.approx(0.0, abs=1e-4)


def test_command_efforts_keep_both_integrals_of_a_jump_inside_a_step():
    # The command jumps from 0 to 1 after 0.004 of a step of 0.01: the integral is 0.006, the double
    # integral 0.006^2 / 2.
    windows = windows_of([0.0, 1.004], [0.0, 1.0], [1.0], 0.01, 1)
    start, slope = efforts(windows)
    a, b, h = start[0, 0], slope[0, 0], 0.01
    assert a * h + b * h**2 / 2 == pytest.approx(0.006, abs=1e-9)
    assert a * h**2 / 2 + b * h**3 / 6 == pytest.approx(0.006**2 / 2, abs=1e-9)


@pytest.mark.parametrize("name", ["actuation_delay__delay", "sensing_delay__delay"])
def test_command_efforts_shift_by_the_delay(name):
    windows = windows_of([0.0, 1.0], [0.0, 1.0], [0.9], 0.01, 20)
    start, slope = efforts(windows, **{name: 0.03})
    middle = (start + 0.5 * 0.01 * slope)[0]
    assert middle[:13] == pytest.approx(0.0, abs=1e-6)
    assert middle[13:] == pytest.approx(1.0, abs=1e-6)


def test_command_efforts_of_a_lag_follow_its_step_response():
    windows = windows_of([0.0, 1.0], [0.0, 1.0], [1.0], 0.01, 30)
    start, slope = efforts(windows, lag__time_constant=0.05)
    mean = (start + 0.5 * 0.01 * slope)[0]
    edge = 0.01 * np.arange(31)
    integral = edge - 0.05 * (1.0 - np.exp(-edge / 0.05))
    assert mean == pytest.approx(np.diff(integral) / 0.01, abs=1e-6)


def test_command_efforts_apply_the_dead_zone():
    windows = windows_of([0.0, 0.5], [0.2, -1.0], [0.1, 0.6], 0.01, 10)
    start, _ = efforts(windows, dead_zone__width=0.3)
    assert start[0] == pytest.approx(0.0, abs=1e-9)
    assert start[1] == pytest.approx(-0.7, abs=1e-6)


def test_command_efforts_hold_the_first_command_before_the_log():
    windows = windows_of([0.0], [1.5], [0.0], 0.01, 5)
    start, _ = efforts(windows, actuation_delay__delay=0.3)
    assert start == pytest.approx(1.5, abs=1e-6)
    assert replace(windows, step=0.02).length == pytest.approx(0.1)


def test_command_efforts_are_smooth_in_the_delay():
    """A held command that jumps every 2 ms: the integral up to a node is linear in the delay within a piece."""
    rng = np.random.default_rng(0)
    windows = windows_of(0.002 * np.arange(600), rng.normal(size=600), [0.5], 0.0047, 40)

    def area(delay):
        start, slope = efforts(windows, actuation_delay__delay=delay)
        return 0.0047 * start + 0.5 * 0.0047**2 * slope

    # No node of a step crosses a jump between these delays (nodes are multiples of 0.1 ms off the jumps).
    bent = area(0.00001) - 2.0 * area(0.00004) + area(0.00007)
    assert np.abs(bent).max() < 1e-12
    assert np.abs(area(0.00007) - area(0.00001)).max() > 1e-5


@pytest.mark.parametrize(
    ("short", "long"), [(0.0, 0.04), (0.013, 0.04), (0.04, 0.04), (0.04, 0.0400001), (1e-4, 0.3)]
)
def test_held_efforts_of_two_lags_match_the_differential_equation(short, long):
    """Irregular commands through two lags, against the state-space solution at much finer times."""
    rng = np.random.default_rng(3)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.001, 0.03, 60))])
    command = CommandSeries(t, rng.standard_normal(len(t)))
    series = HeldEfforts(command, command.value[None], [np.array([long]), np.array([short])])
    step, steps = 0.01, 60
    a, b = series.steps(np.array([0]), np.zeros((1, 1)), np.array([0.2]), step, steps)
    fine = 500  # points of each piece of constant command
    state, at, out = np.full(2, command.value[0]), [0.0], [command.value[0]]
    for begin, end, u in zip(t[:-1], t[1:], command.value[:-1], strict=True):
        for _ in range(fine):
            h = (end - begin) / fine
            # The input of each lag is held at its value in the middle of the substep.
            before = state[0]
            state[0] = u + (before - u) * (np.exp(-h / short) if short else 0.0)
            given = u + (before - u) * np.exp(-0.5 * h / short) if short else u
            state[1] = given + (state[1] - given) * np.exp(-h / long)
            at.append(at[-1] + h)
            out.append(state[1])
    once = np.concatenate([[0.0], np.cumsum(0.5 * (np.diff(at) * (np.array(out[1:]) + np.array(out[:-1]))))])
    edges = 0.2 + step * np.arange(steps + 1)
    wanted = np.diff(np.interp(edges, at, once)) / step
    assert (a + 0.5 * step * b)[:, 0, 0] == pytest.approx(wanted, abs=3e-5)
    # The slope keeps the double integral too.
    twice = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(at) * (once[1:] + once[:-1]))])
    inside = np.diff(np.interp(edges, at, twice)) - step * np.interp(edges[:-1], at, once)
    assert (a * step**2 / 2 + b * step**3 / 6)[:, 0, 0] == pytest.approx(inside, abs=1e-7)


@pytest.mark.parametrize("lag", [0.0, 0.03])
def test_held_efforts_equal_their_formulas_on_whole_arrays(lag):
    """All rows, windows and nodes at once in numpy, with the recursion of the lag written out."""
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.001, 0.02, 200))
    effort, t0, step, steps = rng.standard_normal((3, 200)), np.array([-0.05, 0.4, 1.9]), 0.007, 40
    row, delay = np.array([2, 0, 1, 2]), rng.uniform(0.0, 0.05, (4, 3))
    series = HeldEfforts(CommandSeries(t, effort[0]), effort, [np.array([0.0, lag, lag])])
    gap = np.diff(t)
    once = np.cumsum(np.column_stack([np.zeros(3), effort[:, :-1] * gap]), axis=1)
    way = once[:, :-1] * gap + 0.5 * effort[:, :-1] * gap**2
    twice = np.cumsum(np.column_stack([np.zeros(3), way]), axis=1)
    deviation = np.zeros((3, 200))
    for i in range(199) if lag else ():
        jump = effort[1:, i] - effort[1:, i + 1]
        deviation[1:, i + 1] = np.exp(-gap[i] / lag) * deviation[1:, i] + jump
    at = (t0[:, None] + step * np.arange(steps + 1))[None] - delay[..., None]
    piece = np.clip(np.searchsorted(t, at, side="right") - 1, 0, None)
    lane, inside = row[:, None, None], at - t[piece]
    now, before = effort[lane, piece], once[lane, piece]
    single = before + now * inside
    double = twice[lane, piece] + inside * (before + 0.5 * now * inside)
    if lag:
        left = deviation[lane, piece] * np.exp(-np.maximum(inside, 0.0) / lag)
        own, start = (row > 0)[:, None, None] * lag, effort[row, 0][:, None, None]
        single = single - own * (now + left - start)
        double = double - own * (single - start * (at - t[0]))
    first, second = np.diff(single, axis=2), np.diff(double, axis=2) - step * single[:, :, :-1]
    slope = 12.0 * (0.5 * step * first - second) / step**3
    a, b = series.steps(row, delay, t0, step, steps)
    assert a == pytest.approx((first / step - 0.5 * step * slope).T, abs=1e-9)
    assert b == pytest.approx(slope.T, abs=1e-6)


def test_command_efforts_of_one_command_are_in_steady_state():
    windows = windows_of([0.0], [1.5], [0.0], 0.01, 5)
    start, slope = efforts(windows, lag__time_constant=0.05, actuation_delay__delay=0.02)
    assert start == pytest.approx(1.5, abs=1e-9)
    assert slope == pytest.approx(0.0, abs=1e-6)


class TwiceLagged(RodPendulum):
    """A pendulum whose motor has two lags."""

    def command_timing(self, index, parameters):
        own = tuple(torch.tensor(lag, dtype=torch.float64) for lag in (0.02, 0.03))
        return super().command_timing(index, parameters)._replace(lag=own)


def test_command_efforts_refuse_three_lags_and_ignore_a_lag_of_zero():
    system = ExtendedSystem(TwiceLagged(), ("lag",))
    windows = windows_of([0.0, 1.0], [0.0, 1.0], [1.0], 0.01, 30)
    p = system.default_parameters()
    without = step_efforts(system, windows, p, 1)
    two = HeldEfforts(
        windows.commands[0], np.array([[0.0, 1.0]]), [np.array([0.02]), np.array([0.03])]
    ).steps(np.array([0]), np.zeros((1, 1)), windows.t0, 0.01, 30)
    assert pytest.approx(two[0], abs=1e-12) == without[0].numpy().T
    with pytest.raises(TooManyLagsError, match=r'rod_pendulum: the command ".*" has 3 lags in series'):
        step_efforts(system, windows, p | {"lag.time_constant": torch.tensor([0.01], dtype=torch.float64)}, 1)


def test_lanes_with_the_same_efforts_share_them():
    """One lane is computed where nothing differs, and lanes that differ get what they get alone."""
    system = ExtendedSystem(make_system("rod_pendulum"), ("gain", "lag", "actuation_delay"))
    rng = np.random.default_rng(7)
    windows = windows_of(0.01 * np.arange(100), rng.normal(size=100), [0.2, 0.5], 0.01, 20)
    given = system.default_parameters()

    def lanes(count, **values):
        own = {n.replace("__", "."): torch.tensor(v, dtype=torch.float64) for n, v in values.items()}
        return step_efforts(system, windows, given | own, count)

    assert lanes(5)[0].stride(0) == 0
    several = lanes(4, gain__factor=[1.0, 1.2, 1.0, 1.2], actuation_delay__delay=[0.01, 0.01, 0.0, 0.01])
    for k, (factor, delay) in enumerate([(1.0, 0.01), (1.2, 0.01), (1.0, 0.0), (1.2, 0.01)]):
        alone = lanes(1, gain__factor=[factor], actuation_delay__delay=[delay])
        assert all(torch.equal(a[k], b[0]) for a, b in zip(several, alone, strict=True))


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_command_efforts_of_an_infinite_lane_do_not_change_other_lanes():
    system = ExtendedSystem(make_system("rod_pendulum"), ("gain", "lag"))
    rng = np.random.default_rng(5)
    windows = windows_of(0.01 * np.arange(100), rng.normal(size=100), [0.2, 0.5], 0.01, 20)

    def lanes(*factors):
        given = {
            "gain.factor": torch.tensor(factors, dtype=torch.float64),
            "lag.time_constant": torch.tensor(0.05, dtype=torch.float64),
        }
        return step_efforts(system, windows, system.default_parameters() | given, len(factors))

    for alone, beside in zip(lanes(0.8, 1.2), lanes(0.8, np.inf, 1.2), strict=True):
        assert torch.equal(beside[[0, 2]], alone)
        assert not torch.isfinite(beside[1]).all()


def assert_as_alone(one, logs, together, values):
    """Windows of several logs have the efforts that each log has by itself."""
    start, slope = efforts(together, **values)
    for w, log in enumerate(together.log):
        own = replace(one.take(np.array([w])), commands=(logs[log],), log=np.zeros(1, dtype=int))
        alone = efforts(own, **values)
        np.testing.assert_array_equal(start[w], alone[0][0])
        np.testing.assert_array_equal(slope[w], alone[1][0])


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"gain__factor": 1.2, "lag__time_constant": 0.03},
        {"backlash__width": 0.2, "actuation_delay__delay": 0.013, "dead_zone__width": 0.05},
        {"saturation__limit": 0.5, "clock_skew__rate": 1e-3, "torque_bias__effort": 0.1},
    ],
)
def test_logs_that_are_computed_together_have_the_efforts_of_each_alone(values):
    rng = np.random.default_rng(1)
    t, other = np.arange(0.0, 3.0, 0.05), np.sort(rng.uniform(0.0, 3.0, 60))
    logs = [CommandSeries(stamps, rng.uniform(-1.0, 1.0, 60)) for stamps in (t, other, t)]
    one = windows_of(t, logs[0].value, [0.5, 1.0, 1.5, 2.0], 0.01, 40)
    together = replace(one, commands=tuple(logs), log=np.array([2, 0, 1, 2]))
    assert_as_alone(one, logs, together, values)


@pytest.mark.parametrize("values", [{}, {"lag__time_constant": 0.03, "actuation_delay__delay": 0.013}])
def test_copies_of_a_log_with_the_same_windows_have_the_efforts_of_each_alone(values):
    rng, t = np.random.default_rng(2), np.arange(0.0, 3.0, 0.05)
    logs = [CommandSeries(t, rng.uniform(-1.0, 1.0, 60)) for _ in range(3)]
    one = windows_of(t, logs[0].value, [0.5, 1.5, 0.5, 0.5, 1.5, 1.5], 0.01, 40)
    together = replace(one, commands=tuple(logs), log=np.array([2, 0, 1, 0, 2, 1]))
    assert_as_alone(one, logs, together, values)
