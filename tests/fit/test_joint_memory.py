"""Effects that remember the way of a joint, along a log, against solutions of their differential equations."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.simulate.simulator import predict
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import ExtendedSystem, MemoryEffectError, make_system

LEVEL, DISTANCE, RELAXATION = 0.5, 0.02, 0.01
SYSTEM = "torque_pendulum"


def torque(t):
    """Slow swings with quick ones on top, held for 20 ms each."""
    held = np.floor(np.asarray(t) / 0.02 + 1e-9) * 0.02
    return 0.9 * np.sin(2.0 * held) + 0.5 * np.sin(9.0 * held)


def log(seconds):
    t = np.arange(round(seconds * 100)) / 100.0
    sent = t[::2]
    return Recording(
        {
            "theta": Series(t, 0.3 * np.sin(t), "rad", "measurement"),
            "omega": Series(t, 0.3 * np.cos(t), "rad/s", "measurement"),
            "torque": Series(sent, torque(sent), "N m", "command"),
        },
        system=SYSTEM,
    )


def solved(start, bend, t0, times, level=LEVEL, spring=(0.0, 0.0)):
    """Angle, speed and bend of the bristles by another solver, in small steps."""
    p = {q.name: q.value for q in make_system(SYSTEM).parameters}

    def slope(t, y):
        q, v, z = y
        rate = (v - z * abs(v)) / DISTANCE
        load = -level * (z + np.clip(RELAXATION * rate, -1.0, 1.0))
        load -= spring[0] * (q - spring[1])
        free = torque(t0 + t) - p["gravity_torque"] * np.sin(q) - p["viscous"] * v
        return v, (free + load) / p["inertia"], rate

    return solve_ivp(
        slope, (0.0, times[-1]), [*start, bend], t_eval=times, max_step=5e-4, rtol=1e-8, atol=1e-10
    ).y


def test_bristles_bend_and_slip_as_their_differential_equation_says():
    values = {"bristle.level": LEVEL, "bristle.distance": DISTANCE, "bristle.relaxation": RELAXATION}
    system = ExtendedSystem(make_system(SYSTEM), ("bristle",), values)
    windows = cut_windows([log(3.0)], system, 2.0)
    start = (0.1, 0.8)  # moving, so the bristles are bent fully
    initial = torch.tensor(start, dtype=torch.float64).expand(1, len(windows), 2)
    found = predict(system, windows, system.default_parameters(), initial)[0, 0]
    times = windows.t[0, 0].numpy()
    y = solved(start, 1.0, float(windows.t0[0]), times)
    assert np.ptp(np.sign(y[1])) == 2.0  # it turns
    assert found[0].numpy() == pytest.approx(y[0], abs=3e-4)
    assert found[1].numpy() == pytest.approx(y[1], abs=1e-2)


def lugre_of(start, bend, t0, times, ratio, speed):
    """Angle and speed with LuGre friction by another solver (Canudas de Wit et al. 1995), z in metres of bristles."""
    p = {q.name: q.value for q in make_system(SYSTEM).parameters}
    stiffness = LEVEL / DISTANCE

    def slope(t, y):
        q, v, z = y
        most = LEVEL * (1.0 + ratio * np.exp(-((v / speed) ** 2)))
        rate = v - stiffness * z * abs(v) / most
        load = -stiffness * z - np.clip(stiffness * RELAXATION * rate, -LEVEL, LEVEL)
        free = torque(t0 + t) - p["gravity_torque"] * np.sin(q) - p["viscous"] * v
        return v, (free + load) / p["inertia"], rate

    first = [*start, bend * DISTANCE]
    return solve_ivp(slope, (0.0, times[-1]), first, t_eval=times, max_step=5e-4, rtol=1e-8, atol=1e-10).y


def test_friction_of_lugre_follows_its_differential_equation():
    ratio, speed = 0.6, 0.3
    own = {"level": LEVEL, "distance": DISTANCE, "relaxation": RELAXATION, "ratio": ratio, "speed": speed}
    system = ExtendedSystem(make_system(SYSTEM), ("lugre",), {f"lugre.{n}": v for n, v in own.items()})
    windows = cut_windows([log(3.0)], system, 2.0)
    start = (0.1, 1.8)
    initial = torch.tensor(start, dtype=torch.float64).expand(1, len(windows), 2)
    found = predict(system, windows, system.default_parameters(), initial)[0, 0]
    y = lugre_of(start, 1.0, float(windows.t0[0]), windows.t[0, 0].numpy(), ratio, speed)
    assert np.ptp(np.sign(y[1])) == 2.0  # it turns
    assert found[0].numpy() == pytest.approx(y[0], abs=1e-3)


def test_friction_of_lugre_without_excess_is_that_of_bristles():
    own = {"level": LEVEL, "distance": DISTANCE}
    found = []
    for name in ("bristle", "lugre"):
        system = ExtendedSystem(make_system(SYSTEM), (name,), {f"{name}.{n}": v for n, v in own.items()})
        windows = cut_windows([log(3.0)], system, 2.0)
        initial = torch.tensor([0.1, 0.2], dtype=torch.float64).expand(1, len(windows), 2)
        found.append(predict(system, windows, system.default_parameters(), initial))
    assert torch.allclose(*found, rtol=0.0, atol=1e-12)


def test_bristles_hold_a_joint_at_rest_and_let_it_spring_back():
    values = {"bristle.level": LEVEL, "bristle.distance": DISTANCE}
    system = ExtendedSystem(make_system(SYSTEM), ("bristle",), values)
    still = log(3.0)
    command = still.channels["torque"]
    still.channels["torque"] = Series(command.t, np.zeros(len(command.t)), "N m", "command")
    windows = replace(cut_windows([still], system, 2.0), way=None)  # it did not come from where this log was
    # The weight at 0.1 rad asks for 0.3 N m of the 0.5 N m that bristles hold; then at 0.3 rad for 0.9 N m.
    for angle, stays in ((0.1, True), (0.3, False)):
        initial = torch.tensor([angle, 0.0], dtype=torch.float64).expand(1, len(windows), 2)
        found = predict(system, windows, system.default_parameters(), initial)[0, 0, 0].numpy()
        assert (np.abs(found - angle).max() < 1e-9) == stays


def test_bristles_without_a_level_leave_the_derivative_as_it_is():
    base = make_system(SYSTEM)
    system = ExtendedSystem(base, ("bristle",))
    state, effort = torch.tensor([0.3, -0.2], dtype=torch.float64), torch.tensor(0.4, dtype=torch.float64)
    slope = system.derivative(state, effort, system.default_parameters())
    assert torch.equal(slope, base.derivative(state, effort, base.default_parameters()))


def test_bristles_need_a_log():
    system = ExtendedSystem(make_system(SYSTEM), ("bristle",), {"bristle.level": LEVEL})
    with pytest.raises(MemoryEffectError, match="bristle remembers the way of its joint"):
        system.derivative(
            torch.zeros(2, dtype=torch.float64),
            torch.zeros((), dtype=torch.float64),
            system.default_parameters(),
        )


def driven(system, windows, initial):
    return predict(system, windows, system.default_parameters(), initial)[0, 0]


def moving(count):
    return torch.tensor([0.1, 0.8], dtype=torch.float64).expand(1, count, 2)


def test_output_of_a_gear_with_play_follows_once_the_play_is_crossed():
    base, width = make_system(SYSTEM), 0.03
    system = ExtendedSystem(base, ("gear_play",), {"gear_play.width": width})
    windows = cut_windows([log(3.0)], base, 2.0)
    initial = moving(len(windows))
    found = driven(system, windows, initial)
    t = windows.t[0, 0].numpy()
    fine = solved((0.1, 0.8), 0.0, float(windows.t0[0]), np.linspace(0.0, t[-1], 20_001), level=0.0)
    output, at = [], 0.1 - width  # it moved upwards before
    for q in fine[0]:
        at = min(max(at, q - width), q + width)
        output.append(at)
    expected = np.interp(t, np.linspace(0.0, t[-1], 20_001), output)
    assert np.ptp(expected) > 0.5
    assert found[0].numpy() == pytest.approx(expected, abs=1e-3)
    rests = np.abs(np.gradient(expected, t)) < 1e-9
    assert rests.any()
    assert np.count_nonzero(found[1].numpy() == 0.0) == pytest.approx(rests.sum(), abs=4)


def test_spring_pulls_as_its_equation_says():
    values = {"spring.stiffness": 2.0, "spring.centre": 0.4}
    system = ExtendedSystem(make_system(SYSTEM), ("spring",), values)
    windows = cut_windows([log(3.0)], system, 2.0)
    found = driven(system, windows, moving(len(windows)))
    t = windows.t[0, 0].numpy()
    y = solved((0.1, 0.8), 0.0, float(windows.t0[0]), t, level=0.0, spring=(2.0, 0.4))
    assert found[0].numpy() == pytest.approx(y[0], abs=1e-5)


def test_effort_goes_to_its_command_at_a_limited_rate():
    system = ExtendedSystem(make_system(SYSTEM), ("rate_limit",), {"rate_limit.limit": 12.0})
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.01, 0.05, 60))
    command = np.repeat(rng.uniform(-2.0, 2.0, 20), 3)
    got = system.shape_command(
        0, torch.tensor(command)[:, None], torch.tensor(t), system.default_parameters()
    )
    # An effort that moves in steps of 10 us, averaged over the time for which each command is held.
    effort, expected = command[0], []
    for k in range(len(t) - 1):
        steps = round((t[k + 1] - t[k]) / 1e-5)
        h, total = (t[k + 1] - t[k]) / steps, 0.0
        for _ in range(steps):
            change = np.clip(command[k] - effort, -12.0 * h, 12.0 * h)
            total += effort + 0.5 * change
            effort += change
        expected.append(total / steps)
    assert got[:-1, 0].numpy() == pytest.approx(np.array(expected), abs=1e-4)


@pytest.mark.parametrize("effect", ["spring", "gear_play", "rate_limit", "bristle"])
@pytest.mark.parametrize("name", ["torque_pendulum", "two_link_arm"])
def test_null_values_give_the_motion_of_the_base_exactly(effect, name):
    base = make_system(name)
    rng = np.random.default_rng(1)
    t = np.arange(200) / 100.0
    channels = {
        c.name: Series(t, np.sin(t + k), c.unit, "measurement") for k, c in enumerate(base.measurements)
    }
    for c in base.commands:
        channels[c.name] = Series(t, rng.uniform(c.low, c.high, len(t)), c.unit, "command")
    windows = cut_windows([Recording(channels, system=name)], base, 1.0)
    plain = predict(base, windows, base.default_parameters(), windows.state[None])
    for site in [base.at_joint(effect, j) for j in range(base.joints)]:
        system = ExtendedSystem(base, (site,))
        found = predict(system, windows, system.default_parameters(), windows.state[None])
        assert torch.equal(found, plain)
