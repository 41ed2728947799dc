# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""The charge for initial positions that only a cause makes count."""

import math
from dataclasses import replace

import numpy as np
import pytest

from deepkoco import Channel, Parameter, System
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.freed_positions import hidden_positions, with_freed_positions
from deepkoco.diagnose.evidence.ranking import penalty
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.logs.recording import Recording, Series

INERTIA, TORQUE, OIL = 0.004, 3.0, 0.01
NAMES = ("cogging", "spring", "viscous", "coulomb", "gain", "lag", "periodic", "speed_bias(speed)")


SPEED = Channel("speed", "rad/s", "measurement", noise_sd=0.2)


class Spindle(System):
    """A motor turns a spindle in oil; a tachometer alone."""

    weight = 0.0  # m g d [N m]
    joint_units = ("rad",)
    parameters = (
        Parameter("inertia", INERTIA, "kg m2", 1e-4, 0.1, 1e-4, "of all that turns"),
        Parameter("torque", TORQUE, "N m", 0.1, 30.0, 0.1, "at full duty"),
        Parameter("oil", OIL, "N m s/rad", 0.0, 0.5, 1e-3, "friction"),
    )
    commands = (Channel("duty", "1", "command", 0.0, 1.0),)
    measurements = (SPEED,)
    measured_states = (1,)

    def ideal_measurement(self, state):
        return state[..., [*self.measured_states]]

    def accelerations(self, p):
        def law(s):
            driven = p["torque"] * s.efforts[0] - p["oil"] * s.speeds[0] + s.load(0)
            return ((driven - self.weight * s.angles[0].sin()) / p["inertia"],)

        return law


class Eccentric(Spindle):
    """With a weight beside its axis."""

    weight = 0.4


class Encoded(Spindle):
    """With an encoder."""

    measurements = (Channel("angle", "rad", "measurement", noise_sd=1e-3), SPEED)
    measured_states = (0, 1)


def spun(seed=0, seconds=12.0):
    """A log of the unit without any weight: exact between commands at 50 Hz, samples at each."""
    rng, step = np.random.default_rng(seed), 0.02
    duty = 0.5 + np.repeat(rng.uniform(-0.3, 0.3, 200), rng.integers(10, 40, 200))[: int(seconds / step)]
    decay, speed, angle, speeds, angles = math.exp(-OIL / INERTIA * step), 120.0, 0.0, [], []
    for u in duty:
        speeds.append(speed)
        angles.append(angle)
        end = TORQUE * u / OIL
        angle += end * step + (speed - end) * (1.0 - decay) * INERTIA / OIL
        speed = end + (speed - end) * decay
    t = step * np.arange(len(duty))
    noisy = np.array(speeds) + 0.2 * rng.standard_normal(len(t))
    return Recording(
        {
            "duty": Series(t, duty, "1", "command"),
            "speed": Series(t, noisy, "rad/s", "measurement"),
            "angle": Series(t, np.array(angles) + 1e-3 * rng.standard_normal(len(t)), "rad", "measurement"),
        },
        None,
        None,
        {},
    )


def states_of(system, charged=0):
    log = spun()
    names = {c.name for c in (*system.commands, *system.measurements)}
    log = Recording({n: s for n, s in log.channels.items() if n in names}, None, None, {})
    windows = cut_windows([log], system, 1.5)
    start = baseline_from(system, windows)
    problem, every = FitProblem(start.system, windows), catalogue(system)
    reference = problem.fit_one(Trial("refit", start.prior.names, start.prior, start.values, windows.state))
    causes = [replace(every[name], states=charged) for name in NAMES if name in every]
    return windows, {c.name: c for c in with_freed_positions(problem, reference, causes)}


def test_a_load_that_depends_on_an_unseen_position_pays_for_one_in_each_window():
    windows, causes = states_of(Spindle())
    assert hidden_positions(windows) == {0: len(windows)}
    counted = {name: cause.states for name, cause in causes.items()}
    assert counted == {name: len(windows) if name in ("cogging", "spring") else 0 for name in NAMES}
    # Two waves and the phases of 7 windows, each ln of 500 samples, and the number of cycles among 23.
    cause = causes["cogging"]
    bare = penalty(catalogue(Spindle())["cogging"], 500.0, 1)
    assert penalty(cause, 500.0, 1) - bare == pytest.approx(len(windows) * math.log(500.0))


def test_no_position_is_freed_where_the_system_or_the_log_tells_it():
    # An eccentric weight: each window's position is part of the refit. An encoder: it is measured.
    for system in (Eccentric(), Encoded()):
        _, causes = states_of(system)
        assert {cause.states for cause in causes.values()} == {0}


def test_a_charge_that_a_cause_has_already_is_kept():
    windows, causes = states_of(Spindle(), 1000)
    assert len(windows) < 1000
    assert {cause.states for cause in causes.values()} == {1000}
