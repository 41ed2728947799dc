"""Values beside a model error: a position servo whose friction has another form than that of the catalogue."""

from dataclasses import replace

import numpy as np
import pytest

from deepkoco import Channel, Parameter, System
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.proportion import in_proportion
from deepkoco.fit import cut_windows
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.logs.recording import Recording, Series

MASS, KV, KP, VISCOUS, FRICTION = 40.0, 20.0, 2000.0, 120.0, 60.0
DRIFTED = 1.7  # times by which all values that multiply out of the motion are too large
SOFT = 8e-3  # speed over which the friction of the unit grows [m/s]; that of the catalogue is there at once


class Axis(System):
    """A table that a cascade of a position and a speed controller drives."""

    joint_units = "m"
    parameters = (
        Parameter("mass", MASS, "kg", 5.0, 200.0, 2.0, "m"),
        Parameter("kv", KV, "1/s", 1.0, 100.0, 1.0, "position controller"),
        Parameter("kp", KP, "N s/m", 100.0, 20000.0, 100.0, "speed controller"),
        Parameter("viscous", 150.0, "N s/m", 0.0, 2000.0, 75.0, "guides"),
    )
    commands = (Channel("goal", "m", "command", -0.3, 0.3),)
    measurements = (Channel("position", "m", "measurement", noise_sd=2e-6),)

    def accelerations(self, p):
        def law(motion):
            x, v = motion.angles[0], motion.speeds[0]
            force = p["kp"] * (p["kv"] * (motion.efforts[0] - x) - v) - p["viscous"] * v + motion.load(0)
            return (force / p["mass"],)

        return law


def axis_log(seconds: float = 8.0, rate: float = 200.0, parts: int = 20) -> Recording:
    """A log under smooth moves between random places; the unit is the model but for its friction."""
    rng = np.random.default_rng(3)
    goal, place = [], 0.0
    while len(goal) < seconds * rate:
        to, steps = rng.uniform(-0.12, 0.12), int(rng.uniform(0.3, 0.8) * rate)
        goal += list(place + (to - place) * 0.5 * (1.0 - np.cos(np.pi * np.arange(1, steps + 1) / steps)))
        place = to
    goal = np.array(goal[: int(seconds * rate)])
    x, v, shown, h = 0.0, 0.0, [], 1.0 / rate / parts
    for wanted in goal:
        shown.append(x)
        for _ in range(parts):
            force = KP * (KV * (wanted - x) - v) - VISCOUS * v - FRICTION * np.tanh(v / SOFT)
            # Implicit in the friction's slope, which is stiff.
            slope = (KP + VISCOUS + FRICTION / SOFT / np.cosh(min(abs(v) / SOFT, 50.0)) ** 2) / MASS
            v += h * force / MASS / (1.0 + h * slope)
            x += h * v
    t = np.arange(len(goal)) / rate
    position = np.array(shown) + 1e-6 * rng.standard_normal(len(goal))
    return Recording(
        {"goal": Series(t, goal, "m", "command"), "position": Series(t, position, "m", "measurement")}
    )


@pytest.fixture(scope="module")
def fitted():
    system = Axis()
    windows = cut_windows([axis_log()], system, 1.0)
    start = baseline_from(system, windows)
    windows, refit = refit_sharply(start, windows)
    problem, cause = FitProblem(start.system, windows), catalogue(system)["coulomb"]
    values = {**refit.values, **dict.fromkeys(cause.free, 50.0)}
    trial = Trial("coulomb", (*refit.free, *cause.free), start.prior, values, refit.state)
    for _ in range(2):  # the prior of a cause is as wide as its size
        prior = prior_with(problem, start, (cause,), values)
        fit = problem.fit([replace(trial, prior=prior, values=values)], 60)[0]
        values = fit.values
    # Only the ratios to the mass show, so a fit may end anywhere along them: its model error outweighs every prior.
    along = {n: DRIFTED * values[n] for n in ("mass", "kp", "viscous", *cause.free)}
    prior = prior_with(problem, start, (cause,), {**values, **along})
    fit = problem.fit([replace(trial, prior=prior, values={**values, **along}, state=fit.state)], 1)[0]
    return problem, start, cause, fit


def away(start, fit):
    sd = np.sqrt(start.prior.covariance.diagonal())
    return max(
        abs(fit.values[n] - m) / s for n, m, s in zip(start.prior.names, start.prior.centre, sd, strict=True)
    )


def test_a_model_error_does_not_outweigh_what_is_known_of_the_machine(fitted):
    problem, start, cause, fit = fitted
    assert fit.chi2 > 2.0 * problem.windows.samples
    assert away(start, fit) > 2.0  # as if each sample of the model error were news
    shown = in_proportion(problem, start, (cause,), fit)
    assert away(start, shown) < 1.0
    (name,) = cause.free
    assert shown.values[name] == pytest.approx(FRICTION, rel=0.05)
    # The interval tells how well the friction is known: the priors of mass and gains leave 5 % open.
    sd = np.sqrt(dispersion(shown, problem.windows).deflation * shown.covariance[-1, -1])
    assert 0.01 * FRICTION < sd < 0.1 * FRICTION


def test_a_fit_that_leaves_noise_stays_as_it_is(fitted):
    problem, start, cause, fit = fitted
    assert in_proportion(problem, start, (), fit) is fit
    quiet = problem.windows.samples * 0.9
    calm = replace(fit, chi2=quiet)
    assert in_proportion(problem, start, (cause,), calm) is calm
