"""Effects that remember the way of a joint, along a log, against solutions of their differential equations."""

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


def solved(start, bend, t0, times):
    """Angles from a stiff solver of the equations with the state of the bristles."""
    p = {q.name: q.value for q in make_system(SYSTEM).parameters}

    def slope(t, y):
        q, v, z = y
        rate = (v - z * abs(v)) / DISTANCE
        load = -LEVEL * (z + np.clip(RELAXATION * rate, -1.0, 1.0))
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


def test_bristles_hold_a_joint_at_rest_and_let_it_spring_back():
    values = {"bristle.level": LEVEL, "bristle.distance": DISTANCE}
    system = ExtendedSystem(make_system(SYSTEM), ("bristle",), values)
    still = log(3.0)
    command = still.channels["torque"]
    still.channels["torque"] = Series(command.t, np.zeros(len(command.t)), "N m", "command")
    windows = cut_windows([still], system, 2.0)
    # The weight at 0.1 rad asks for 0.3 N m of the 0.5 N m that bristles hold; then at 0.3 rad for 0.9 N m.
    for angle, stays in ((0.1, True), (0.3, False)):
        initial = torch.tensor([angle, 0.0], dtype=torch.float64).expand(1, len(windows), 2)
        found = predict(system, windows, system.default_parameters(), initial)[0, 0, 0].numpy()
        assert (np.abs(found - angle).max() < 1e-9) == stays


def test_bristles_without_a_level_change_nothing():
    base = make_system(SYSTEM)
    system = ExtendedSystem(base, ("bristle",))
    windows = cut_windows([log(3.0)], base, 1.0)
    initial = windows.state[None]
    plain = predict(base, windows, base.default_parameters(), initial)
    assert torch.equal(predict(system, windows, system.default_parameters(), initial), plain)
    state, effort = initial[0], torch.zeros(len(windows), dtype=torch.float64)
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
