"""Known differences of logs, and commands that are not logged, on a servo simulated by SciPy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit
from deepkoco.fit.data.per_log_differences import known_of
from deepkoco.fit.data.windows import cut_windows
from deepkoco.logs.recording import LogError, Recording, Series
from deepkoco.systems import make_system

STIFFNESS, DAMPING, INERTIA, WEIGHT, VISCOUS = 9.2, 0.27, 0.0095, 0.06, 0.03


def servo_log(
    mass: float, known: float | None = None, off_at: float = 1e9, seconds: float = 3.0
) -> Recording:
    """A position servo with a mass at 0.15 m that follows a sum of sinusoids; switched off at a time."""
    inertia, weight = INERTIA + mass * 0.15**2, WEIGHT + mass * 9.81 * 0.15
    t = 0.01 * np.arange(round(100 * seconds))
    goal = 0.6 * np.sin(2.5 * t) + 0.3 * np.sin(9.0 * t)
    enable = (t < off_at - 1e-9).astype(float)

    def law(s, x):
        k = min(int(s / 0.01 + 1e-9), len(t) - 1)
        torque = enable[k] * (STIFFNESS * (goal[k] - x[0]) - DAMPING * x[1])
        return [x[1], (torque - weight * np.sin(x[0]) - VISCOUS * x[1]) / inertia]

    states = [[0.1, 0.0]]
    for k in range(len(t) - 1):  # piece by piece: the goal jumps at every sample
        part = solve_ivp(law, (t[k], t[k + 1] - 1e-12), states[-1], rtol=1e-9, atol=1e-11)
        states.append(part.y[:, -1])
    noise = 0.0005 * np.random.default_rng(round(10 * mass)).normal(size=len(t))
    channels = {
        "goal": Series(t, goal, "rad", "command"),
        "theta": Series(t, np.array(states)[:, 0] + noise, "rad", "measurement"),
    }
    if off_at < t[-1]:
        channels["enable"] = Series(t, enable, "1", "command")
    meta = {} if known is None else {"known": {"payload.mass": known}}
    return Recording(channels, meta=meta)


def fitted(logs):
    system = make_system("servo_pendulum")
    windows = cut_windows(logs, system, 1.0)
    fit = refit(baseline_from(system, windows), windows)
    return {n: fit.values[n] for n in fit.free}, fit.chi2 / windows.samples


def test_refit_spans_logs_with_known_payloads():
    logs = [servo_log(0.0, off_at=2.0), servo_log(0.4, known=0.4, off_at=2.0)]
    found, left = fitted(logs)
    assert left < 1.2
    truth = dict(
        stiffness=STIFFNESS, damping=DAMPING, inertia=INERTIA, gravity_torque=WEIGHT, viscous=VISCOUS
    )
    for name, value in truth.items():
        assert found[name] == pytest.approx(value, rel=0.04), name
    _, unaware = fitted([replace(log, meta={}) for log in logs])
    assert unaware > 10.0 * left


def test_cut_windows_uses_the_default_of_an_unlogged_command():
    system = make_system("servo_pendulum")
    windows = cut_windows([servo_log(0.0, seconds=1.5)], system, 1.0)
    assert windows.commands[0].column(1).tolist() == [1.0] * 150


@pytest.mark.parametrize(
    ("known", "message"),
    [
        ({"payload.mas": 1.0}, 'servo_pendulum has no parameter "payload.mas" that may differ'),
        ({"gain.factor": 1.0}, "gain.factor"),  # effects on commands cannot differ from log to log
        ({"payload.mass": "1 kg"}, "expected a number in the parameter's unit, got '1 kg'"),
        ({"payload.mass": float("nan")}, "expected a number"),
        (["payload"], "expected parameters and numbers"),
    ],
)
def test_known_of_refuses_wrong_differences(known, message):
    with pytest.raises(LogError, match=message):
        known_of([replace(servo_log(0.0, seconds=0.1), meta={"known": known})], make_system("servo_pendulum"))
