# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""Initial states that fits lend each other where a gyro alone shows the motion."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from deepkoco import Channel, Parameter, System
from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.exchanged_states import hides_a_position, with_exchanged_states
from deepkoco.diagnose.evidence.footholds import trial_of
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking
from deepkoco.diagnose.residuals.residuals import dispersion
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system

INERTIA, WEIGHT, DAMPING, NOISE = 0.02, 0.4, 0.02, 0.01


class Tumbler(System):
    """A body on an axis, driven by a thruster on each side; a gyro alone."""

    joint_units = ("rad",)
    parameters = (
        Parameter("inertia", INERTIA, "kg m2", 1e-3, 0.1, 1e-3, "about the axis"),
        Parameter("weight", WEIGHT, "N m", 0.01, 5.0, 0.02, "m g d"),
        Parameter("damping", DAMPING, "N m s/rad", 0.0, 0.5, 0.002, "of the bearing"),
    )
    commands = (Channel("left", "1", "command", 0.0, 1.0), Channel("right", "1", "command", 0.0, 1.0))
    measurements = (Channel("gyro", "rad/s", "measurement", noise_sd=NOISE),)
    measured_states = (1,)
    command_joints = (0, 0)

    def ideal_measurement(self, state: torch.Tensor) -> torch.Tensor:
        return state[..., [1]]

    def accelerations(self, p):
        def law(s):
            lift = 1.5 * (s.efforts[0] ** 2 - s.efforts[1] ** 2)
            load = lift - p["weight"] * torch.sin(s.angles[0]) - p["damping"] * s.speeds[0] + s.load(0)
            return (load / p["inertia"],)

        return law


def tumbling(weak: float, seed: int, seconds: float = 15.0) -> Recording:
    """A log of a unit whose right side answers a command with a share of it; midpoint rule, commands at 50 Hz."""
    rng, step = np.random.default_rng(seed), 1e-3
    sent = (
        0.5 + np.repeat(rng.uniform(-0.25, 0.25, (400, 2)), rng.integers(5, 30, 400), 0)[: int(50 * seconds)]
    )
    angle, speed, seen = 0.0, 0.0, []
    for left, right in sent:
        lift = 1.5 * (left**2 - (weak * right) ** 2)

        def slope(q, v, lift=lift):
            return (lift - WEIGHT * math.sin(q) - DAMPING * v) / INERTIA

        for k in range(20):
            if k % 10 == 0:
                seen.append(speed)
            middle, there = angle + 0.5 * step * speed, speed + 0.5 * step * slope(angle, speed)
            angle, speed = angle + step * there, speed + step * slope(middle, there)
    t = np.arange(len(seen)) * 0.01
    held = np.arange(len(sent)) * 0.02
    channels = {name: Series(held, sent[:, k], "1", "command") for k, name in enumerate(("left", "right"))}
    gyro = np.array(seen) + NOISE * rng.standard_normal(len(seen))
    return Recording({**channels, "gyro": Series(t, gyro, "rad/s", "measurement")}, None, None, {})


def test_a_fit_goes_on_from_the_states_that_another_has_found():
    windows = cut_windows([tumbling(1.0, 1, 8.0)], Tumbler(), 1.0)
    start = baseline_from(Tumbler(), windows)
    problem, cause = FitProblem(start.system, windows), catalogue(Tumbler())["coulomb"]
    refit = Trial("refit", start.prior.names, start.prior, start.values, windows.state)
    good = problem.fit_one(refit)
    elsewhere = good.state.clone()
    elsewhere[3, 0] += 3.2
    state, _ = problem.fit_states(good.values, elsewhere)
    bad = problem.fit_one(replace(refit, state=state))
    assert bad.cost > good.cost + 100.0
    spread = dispersion(good, windows)
    for reference, begin in ((bad, good.state), (good, state)):
        fit = problem.fit_one(trial_of(problem, start, (), cause, good.values, begin, reference))
        candidate = Candidate(cause, fit, reference.cost - fit.cost, 1.0)
        ranking = Ranking(reference, (candidate,), spread, 1.0, windows.samples)
        better, found = with_exchanged_states(problem, start, (), ranking)
        assert better.cost == pytest.approx(good.cost, abs=1.0)
        assert found.get(cause.name, fit).cost < good.cost + 1.0


def test_only_a_speed_without_its_position_hides_one():
    assert hides_a_position(cut_windows([tumbling(1.0, 1, 8.0)], Tumbler(), 1.0))
    system, t = make_system("rod_pendulum"), np.arange(0.0, 4.0, 0.01)
    channels = {
        c.name: Series(t, np.sin(t), c.unit, c.kind) for c in (*system.commands, *system.measurements)
    }
    assert not hides_a_position(cut_windows([Recording(channels, None, None, {})], system, 1.0))


@pytest.mark.study
def test_the_weak_side_of_a_body_that_turns_over_is_named_by_its_gyro():
    log = tumbling(0.85, 3)
    only = ["gain", "torque_bias", "cogging", "viscous", "coulomb"]
    result = diagnose([log], Tumbler(), only=only)
    assert result.names == ("gain(right)",)
    assert result.causes[0].parameters["gain(right).factor"].value == pytest.approx(0.85, abs=0.005)
