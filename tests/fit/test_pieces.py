"""Integration steps that are cut where held commands jump: lengths, efforts, and the motion of joints that stick."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco import Channel, Parameter, System
from deepkoco.fit.data.noise import Noise
from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.simulate import simulator
from deepkoco.fit.simulate.command_effort import command_efforts
from deepkoco.fit.simulate.interpolation import states_at
from deepkoco.fit.simulate.pieces import FURTHER, pieces_at_jumps
from deepkoco.fit.simulate.simulator import integrate
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.dry_friction import DryFriction
from deepkoco.systems.effects import effects_of

STEP = 0.01


def windows_of(t, value, t0, steps, system, step=STEP):
    count = len(t0)
    none = torch.zeros(count, len(system.measurements), 0, dtype=torch.float64)
    return Windows(
        (CommandSeries(np.array(t, dtype=float), np.array(value, dtype=float)),),
        np.zeros(count, dtype=int),
        np.array(t0, dtype=float),
        step,
        steps,
        none,
        none,
        none.bool(),
        tuple(Noise(0.01, 0.0) for _ in system.measurements),
        torch.zeros(count, 2 * system.joints, dtype=torch.float64),
        np.zeros(count, dtype=bool),
    )


@settings(max_examples=60, deadline=None)
@given(
    delays=st.lists(st.floats(0.0, 0.03), min_size=1, max_size=3),
    gaps=st.lists(st.floats(0.008, 0.02), min_size=5, max_size=30),
    start=st.floats(0.0, 0.1),
)
def test_pieces_end_where_commands_jump(delays, gaps, start):
    t = np.cumsum(gaps)
    late = np.array(delays)[:, None, None]
    jumps = np.ones((len(delays), 1, len(t) - 1), dtype=bool)
    length = pieces_at_jumps(t, jumps, np.zeros(1, dtype=int), late, np.array([start]), STEP, 20)
    assert (length >= 0.0).all()
    np.testing.assert_allclose(length.sum(axis=1), STEP, rtol=1e-12)
    # A piece that there is not comes after all others of its step.
    assert not (length[:, 1:] > 0.0)[length[:, :-1] == 0.0].any()
    begin = STEP * np.arange(20)[:, None] + np.cumsum(length[:, :, 0, 0], axis=1) - length[:, :, 0, 0]
    cuts = np.sort(begin[(length[:, :, 0, 0] > 0.0) & (np.arange(length.shape[1]) > 0)])
    wanted = np.sort(np.concatenate([t[1:] + d - start for d in delays]))
    assert all(np.abs(wanted - cut).min() < 1e-9 for cut in cuts)
    for jump in wanted[(wanted > 0.0) & (wanted < 20 * STEP)]:
        share = jump / STEP % 1.0
        crowded = sum(jump // STEP == other // STEP for other in wanted) > len(delays) + FURTHER
        at_an_edge = min(share, 1.0 - share) < 2e-7
        assert crowded or at_an_edge or np.abs(cuts - jump).min(initial=1.0) < 2e-7 * STEP


def lengths(t, jumps, delay, step, log=(0,)):
    late = np.full((1, 1, len(log)), delay)
    return pieces_at_jumps(t, jumps, np.array(log), late, np.zeros(len(log)), step, 20)


def test_steps_of_several_commands_are_not_cut():
    t, jumps = 0.001 * np.arange(300), np.ones((1, 1, 299), dtype=bool)
    assert lengths(t, jumps, 4e-4, 0.004).shape == (20, 1, 1, 1)
    # A log that repeats each command in four rows has one to a step.
    jumps[..., np.arange(299) % 4 != 3] = False
    assert (lengths(t, jumps, 4e-4, 0.004) > 0.0).sum() == 2 * 19 + 1


def test_a_command_that_stays_cuts_no_step_of_its_own_log():
    t, jumps = 0.01 * np.arange(30), np.ones((1, 2, 29), dtype=bool)
    jumps[0, 1] = False
    found = lengths(t, jumps, 0.004, STEP, log=(1, 0))
    assert (found[:, 1, 0] == 0.0).all()
    assert (found[1:, 1, 1] > 0.0).all()


@pytest.mark.parametrize("lag", [0.0, 0.003, 0.08])
@pytest.mark.parametrize("delay", [0.0037, 0.0100001, 0.021])
def test_efforts_of_pieces_have_the_integrals_of_their_steps(lag, delay):
    """The lines over whole steps come from integrals since the start of the log, those over pieces from their own."""
    system = ExtendedSystem(make_system("rod_pendulum"), ("actuation_delay", "lag", "sensing_delay"))
    rng = np.random.default_rng(1)
    windows = windows_of(np.arange(0.0, 2.0, STEP), rng.normal(size=200), [0.3, 0.5], 40, system)
    values = system.default_parameters() | {
        "actuation_delay.delay": torch.tensor([delay, 0.0, delay], dtype=torch.float64),
        "lag.time_constant": torch.tensor([0.0, 0.0, lag], dtype=torch.float64),
    }
    whole, cut = (command_efforts(system, windows, values, 3, at_jumps=on) for on in (False, True))
    assert whole.length is None
    a, b, h = (x.unflatten(0, (-1, cut.pieces)) for x in (cut.begin[0], cut.slope[0], cut.length))
    area = a * h + b * h**2 / 2.0
    before = area.cumsum(1) - area
    double = (before * h + a * h**2 / 2.0 + b * h**3 / 6.0).sum(1)
    torch.testing.assert_close(
        area.sum(1), whole.begin[0] * STEP + whole.slope[0] * STEP**2 / 2.0, rtol=0.0, atol=1e-11
    )
    torch.testing.assert_close(
        double, whole.begin[0] * STEP**2 / 2.0 + whole.slope[0] * STEP**3 / 6.0, rtol=0.0, atol=1e-11
    )
    # Without a lag, each piece has one of the commands, and no slope.
    real = h[..., 0] > 1e-6
    commands = torch.from_numpy(windows.commands[0].value)
    assert (a[..., 0][real][:, None] - commands).abs().amin(1).max() < 1e-9
    assert b[..., 0][real].abs().max() < 1e-5


class Disc(System):
    """A disc on a bearing with dry friction."""

    joint_units = ("rad",)
    parameters = (
        Parameter("inertia", 0.02, "kg m2", 1e-3, 1.0, 0.005, "J"),
        Parameter("friction", 0.3, "N m", 0.0, 1.0, 0.05, "F"),
    )
    commands = (Channel("torque", "N m", "command", -5.0, 5.0),)
    measurements = (Channel("angle", "rad", "measurement", noise_sd=1e-3),)

    def accelerations(self, p):
        return lambda motion: ((motion.efforts[0] + motion.load(0)) / p["inertia"],)

    def dry_friction_levels(self, p):
        return DryFriction((p["friction"],), (0,))


def slid(torque, friction, inertia, edges, at):
    """Angle at some times of a disc that rests first, under torques that are held between edges: in closed form."""
    times, angle, speed, result = sorted({*edges, *at}), 0.0, 0.0, {}
    for begin, end in itertools.pairwise([*times, times[-1] + 1.0]):
        result[begin] = angle
        u, left = torque(0.5 * (begin + end)), end - begin
        if speed != 0.0:
            a = (u - np.sign(speed) * friction) / inertia
            stop = -speed / a if speed * a < 0.0 else np.inf
            part = min(stop, left)
            angle, speed = (
                angle + speed * part + 0.5 * a * part**2,
                (speed + a * part if part < stop else 0.0),
            )
            left -= part
        if left > 0.0 and speed == 0.0:
            a = np.sign(u) * max(abs(u) - friction, 0.0) / inertia
            angle, speed = angle + 0.5 * a * left**2, a * left
    return np.array([result[t] for t in at])


@pytest.mark.parametrize("delay", [0.0002, 0.0031, 0.005, 0.0087, 0.0133])
def test_a_joint_that_rests_leaves_at_the_jump(delay):
    """Torques below the friction, above it and reversed; the error stays that of rounding in long steps."""
    system = ExtendedSystem(Disc(), ("actuation_delay",))
    value = np.array([0.0, 0.25, 0.6, 0.1, -0.2, -0.7, 0.0, 0.28, 0.9, -0.9] * 3)
    t = STEP * np.arange(30)
    windows = windows_of(t, value, [0.0], 28, system)
    values = system.default_parameters() | {
        "actuation_delay.delay": torch.tensor([delay], dtype=torch.float64)
    }
    nodes = integrate(system, windows, values, torch.zeros(1, 1, 2, dtype=torch.float64))
    at = STEP * np.arange(29)

    def torque(when):
        return value[max(np.searchsorted(t, when - delay, side="right") - 1, 0)]

    wanted = slid(torque, 0.3, 0.02, [*(t + delay)], at)
    assert np.abs(wanted).max() > 1e-3
    np.testing.assert_allclose(nodes.value[0][:, 0, 0], wanted, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("delay", "lag"),
    [((0.0, 1e-7), 0.0), ((0.01, 0.0099999), 0.0), ((0.003, 0.003), 1e-7), ((0.003, 0.0030001), 0.0)],
)
def test_small_differences_of_delays_and_lags_move_joints_that_rest_a_little(delay, lag):
    """No change of how steps are cut shows in finite differences."""
    system = ExtendedSystem(Disc(), ("actuation_delay", "lag"))
    rng = np.random.default_rng(5)
    windows = windows_of(STEP * np.arange(60), rng.uniform(-0.6, 0.6, 60), [0.1, 0.2], 35, system)
    values = system.default_parameters() | {
        "actuation_delay.delay": torch.tensor(delay, dtype=torch.float64),
        "lag.time_constant": torch.tensor([0.0, lag], dtype=torch.float64),
    }
    nodes = integrate(system, windows, values, torch.zeros(2, 2, 2, dtype=torch.float64))
    speed = nodes.value[1]
    assert speed.abs().max() > 0.2
    between = states_at(nodes, torch.full((2, 1), 0.173, dtype=torch.float64), STEP)[..., 1]
    assert (between[..., 1] - between[..., 0]).abs().max() < 35 * 1e-7 * 1.2 / 0.02
    # 1e-7 s under at most 60 rad/s2 more, for each of 35 jumps.
    assert 0.0 < (speed[..., 1] - speed[..., 0]).abs().max() < 35 * 1e-7 * 1.2 / 0.02


def test_speeds_between_nodes_follow_the_way_of_a_step_that_is_cut():
    system = ExtendedSystem(Disc(), ("actuation_delay",))
    windows = windows_of(STEP * np.arange(5), [0.0, 0.6, 0.6, 0.6, 0.6], [0.0], 4, system)
    values = system.default_parameters() | {
        "actuation_delay.delay": torch.tensor([0.009], dtype=torch.float64)
    }
    nodes = integrate(system, windows, values, torch.zeros(1, 1, 2, dtype=torch.float64))
    middle = states_at(nodes, torch.tensor([[0.015]], dtype=torch.float64), STEP)[0, 0, 0]
    # It leaves with 15 rad/s2 at nine tenths of the second step; in its middle it still rests.
    assert float(middle[1]) == pytest.approx(0.0, abs=0.02 * 15.0 * STEP)
    assert float(nodes.value[1][2, 0, 0]) == pytest.approx(0.1 * STEP * 15.0, rel=1e-9)


@pytest.mark.parametrize("jitter", [0.0, 2e-3])
@pytest.mark.parametrize(
    ("name", "extra"),
    [
        ("rod_pendulum", ("coulomb", "gain")),
        ("two_link_arm", ("coulomb(joint 1)", "bristle(joint 2)")),
        ("servo_pendulum", ("stribeck",)),
    ],
)
def test_bytecode_takes_the_pieces_that_torch_takes(name, extra, jitter, monkeypatch):
    rng, base = np.random.default_rng(3), make_system(name)
    delays = tuple(e for e in effects_of(base) if e.startswith("actuation_delay"))
    system = ExtendedSystem(base, (*extra, *delays))
    # With jitter, steps have one, two or no jumps; without, lanes without a delay have none.
    t = np.arange(0.0, 2.0, STEP) + rng.uniform(-jitter, jitter, 200)
    sizes = [min(abs(c.high), 2.0) for c in system.commands]
    windows = windows_of(t, rng.uniform(-1.0, 1.0, (200, len(sizes))) * sizes, [0.4, 0.9, 1.2], 40, system)
    lanes = 6
    values = {
        p.name: torch.from_numpy(np.clip(p.value + p.prior_sd * rng.uniform(0.0, 1.0, lanes), p.low, p.high))
        for p in system.parameters
    }
    for n in values:
        if n.startswith("actuation_delay"):
            values[n][2:4] = 0.0
    start = torch.from_numpy(0.5 * rng.normal(size=(lanes, 3, 2 * system.joints)))
    start[:, 0, system.joints :] = 0.0  # all joints rest
    efforts = command_efforts(system, windows, values, lanes, at_jumps=True)
    assert efforts.length is not None
    cut = (efforts.length.unflatten(0, (-1, efforts.pieces))[:, 1:] > 0.0).any(0).any(0).any(0)
    assert cut.tolist() == [True, True, jitter > 0.0, jitter > 0.0, True, True]
    monkeypatch.setattr(simulator, "in_torch", lambda *_: pytest.fail("no bytecode"))
    fast = integrate(system, windows, values, start)
    monkeypatch.undo()
    monkeypatch.setattr(simulator, "along_windows", lambda *_: None)
    slow = integrate(system, windows, values, start)
    for part, other in zip(fast, slow, strict=True):
        for own, wanted in zip(part, other, strict=True):
            torch.testing.assert_close(own, wanted, rtol=1e-7, atol=1e-8)
