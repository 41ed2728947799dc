"""A motor that turns under dry friction while commands come at 1 kHz: steps are cut until they begin at commands."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from deepkoco import Channel, Parameter, System
from deepkoco.fit import fit as identify
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Trial
from deepkoco.fit.solve.fine_steps import STEP_ROUNDS, fine_steps, steps_to_compare, with_steps_cut
from deepkoco.fit.solve.prior import Prior
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import ExtendedSystem

RATE, SECONDS = 1000, 10
DRIVE, BRAKE, FRICTION, NOISE = 4000.0, 6.6, 217.0, 1.5e-3  # [rad/s^2, 1/s, rad/s^2, rad]


class Motor(System):
    """w' = DRIVE u - BRAKE w - friction."""

    joint_units = ("rad",)
    parameters = (Parameter("friction", FRICTION, "rad/s^2", 0.0, 1e3, 10.0, "dry, over the inertia"),)
    commands = (Channel("duty", "1", "command", -1.0, 1.0),)
    measurements = (Channel("angle", "rad", "measurement", noise_sd=NOISE),)

    def dry_friction_limits(self, p):
        return (p["friction"],)

    def accelerations(self, p):
        def law(motion):
            free = DRIVE * motion.efforts[0] - BRAKE * motion.speeds[0]
            return (free - p["friction"] * motion.direction(0) + motion.load(0),)

        return law


def advanced(angle, speed, command, h):
    """Angle and speed after a time, piece by piece between standstills: the speed decays towards ``end``."""
    while h > 0.0:
        side = np.sign(speed if speed else DRIVE * command)
        if speed == 0.0 and abs(DRIVE * command) <= FRICTION:
            break
        end = (DRIVE * command - FRICTION * side) / BRAKE
        rest = np.log1p(-speed / end) / BRAKE if end * side < 0.0 else np.inf
        piece = min(h, rest)
        decay = np.exp(-BRAKE * piece)
        angle += end * piece + (speed - end) * (1.0 - decay) / BRAKE
        speed = 0.0 if piece == rest else end + (speed - end) * decay
        h -= piece
    return angle, speed


def logged(dither):
    """Commands that jump every 40 to 300 ms and change a little with each row, and the angle of an encoder."""
    rng = np.random.default_rng(20003)
    n = RATE * SECONDS
    u = np.repeat(rng.uniform(-0.4, 0.4, n), rng.integers(40, 300, n))[:n]
    u = u + dither * np.random.default_rng(1).uniform(-1.0, 1.0, n)
    states = [(0.0, 0.0)]
    for command in u[:-1]:
        states.append(advanced(*states[-1], command, 1.0 / RATE))
    angle = np.array(states)[:, 0] + NOISE * rng.standard_normal(n)
    t = np.arange(n) / RATE
    return Recording({"duty": Series(t, u, "1", "command"), "angle": Series(t, angle, "rad", "measurement")})


@pytest.fixture(scope="module")
def log():
    return logged(0.0)


# Steps that hold several commands take these as a line; where rows repeat a command, steps are cut where it changes.
@pytest.mark.parametrize(("dither", "lines"), [(1e-3, True), (0.0, False)])
def test_a_motor_at_1_khz_that_turns_is_simulated_as_exactly_as_its_encoder_shows(dither, lines):
    system = ExtendedSystem(Motor(), ())
    windows = cut_windows([logged(dither)], system, 1.5)
    fit = start = fitted(system, windows)
    for _ in range(STEP_ROUNDS):
        windows = with_steps_cut(windows, fine_steps(partial(FitProblem, system), windows, fit))
        fit = fitted(system, windows)
    # Half of such a step differs little from it in some windows.
    assert (start.chi2 > 5.0 * windows.samples) is lines
    assert fit.chi2 < 1.1 * windows.samples


def test_identify_cuts_the_steps_of_the_motor_until_they_are_fine_enough(log):
    found = identify([log], Motor(), ["friction"])
    friction = found.estimates["friction"]
    assert found.dispersion.chi2_per_sample < 1.1
    assert friction.low < FRICTION < friction.high


def test_a_step_is_compared_with_the_finest_one_where_half_of_it_hides_its_error():
    system = ExtendedSystem(Motor(), ())
    windows = cut_windows([logged(1e-3)], system, 1.5)
    coarse = fitted(system, windows)
    # The same parameters with fine steps reach it. By half a step, chi2 / n is (249^(1/2) - 159^(1/2))^2 = 10 at least.
    better = replace(coarse, chi2=1.1 * windows.samples)
    assert steps_to_compare(partial(FitProblem, system), windows, coarse, better) > 1


def fitted(system, windows):
    problem = FitProblem(system, windows)
    values = dict.fromkeys(problem.names, 0.0) | {"friction": FRICTION}
    return problem.fit_one(Trial("own", (), Prior.empty(), values, windows.state))
