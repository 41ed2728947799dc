"""A wrong parameter of the simulation is named as what it is, and not as a mechanism that imitates it."""

import io
import math
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue, changed_parameter
from deepkoco.diagnose.diagnosis import Estimate
from deepkoco.diagnose.evidence.priors import declared, prior_with
from deepkoco.diagnose.evidence.screening import screen
from deepkoco.diagnose.healthy import learn_baseline
from deepkoco.diagnose.report.text import headline, moved_value, new_value, spoken, terminal_table
from deepkoco.diagnose.verdict.moved import in_ratio, moved_parameters
from deepkoco.excitation.record import record
from deepkoco.fit.data.windows import cut_windows, moving, window_length
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.fit.solve.prior import Prior
from deepkoco.logs.read_logs import read_logs
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import Channel, Parameter, System, load_system, make_system
from deepkoco.unit import make_unit
from tests.diagnose.test_own_robots import CART
from tests.oracle.levitated_ball import Maglev, levitated_ball
from tests.oracle.own_robots import CartPoleUnit
from tests.systems.cart_pole import POLE_MASS, CartPole, cart_pole_log


class Misread(CartPole):
    """A cart-pole whose builder wrote down another mass of the pole; weights at the tip are nothing he knows of."""

    def __init__(self, mass: float, sd: float) -> None:
        super().__init__()
        self.parameters = tuple(
            replace(p, value=mass, prior_sd=sd) if p.name == "pole_mass" else p for p in self.parameters
        )

    def with_payload(self, mass, parameters):
        return dict(parameters)


@pytest.fixture(scope="module")
def cart_log():
    return cart_pole_log(seed=4, seconds=12.0)


def refitted(log, system):
    """Baseline of a log, the problem of its moving windows and the sharp refit there."""
    windows = cut_windows([log], system, window_length(system))
    start = baseline_from(system, windows)
    windows, reference = refit_sharply(start, windows.take(moving(windows)))
    return start, FitProblem(start.system, windows), reference


@pytest.mark.study
def test_wrong_mass_beyond_its_prior_is_the_headline(cart_log):
    result = diagnose([cart_log], Misread(0.12, 0.01))
    assert result.names == ("changed(pole_mass)",)
    (cause,) = result.causes
    assert cause.parameters["pole_mass"].value == pytest.approx(POLE_MASS, rel=0.01)
    assert cause.given == {"pole_mass": 0.12}
    assert headline(result).startswith("pole mass is 0.2 kg, not 0.12 kg (x 1.66")
    assert result.model.parameter("pole_mass").value == pytest.approx(POLE_MASS, rel=0.01)
    # The gain compares with a refit in which the mass stays as given.
    assert result.gain.reduction > 0.5
    terminal_table(result)


@pytest.mark.study
def test_wrong_mass_within_a_wide_prior_is_the_headline_of_nothing(cart_log):
    result = diagnose([cart_log], Misread(0.12, 0.035))
    assert result.verdict == "nothing"
    assert [m.name for m in result.moved] == ["pole_mass"]
    assert headline(result).startswith("pole mass is 0.2 kg, not 0.12 kg")
    console = Console(width=160, file=io.StringIO(), record=True)
    console.print(terminal_table(result))
    assert "extended [m]" in console.export_text()
    assert result.to_json()["fit"]["moved"][0]["given"] == 0.12


@pytest.mark.study
def test_payload_that_is_another_mass_says_so(cart_log):
    light = CartPole()
    light.parameters = tuple(replace(p, value=0.12) if p.name == "pole_mass" else p for p in light.parameters)
    result = diagnose([cart_log], light, only=["payload", "changed"])
    (cause,) = result.causes
    assert cause.name == "payload"
    (same,) = cause.same_as
    assert same.name == "pole_mass"
    assert same.estimate.value == pytest.approx(POLE_MASS, rel=0.01)
    assert "the same as: pole mass is 0.2 kg, not 0.12 kg" in headline(result)


def servo_log(seed, **changed):
    spec = make_unit("torque_pendulum", parameters=changed, sensor={"rate_hz": 100.0}, seed=seed)
    return record(spec, "steps", 15.0, clock="simulated", seed=seed)


@pytest.mark.study
def test_parameter_that_differs_from_healthy_logs_is_named_and_a_control_is_not():
    # The declared spread of the inertia is 34 %: only the healthy logs know it better.
    system = make_system("torque_pendulum")
    baseline = learn_baseline([servo_log(1), servo_log(2)], system, window_length(system))
    found = diagnose([servo_log(3, inertia=0.2)], system, baseline=baseline)
    assert "changed(inertia)" in found.causes[0].members
    assert diagnose([servo_log(4)], system, baseline=baseline).causes == ()


def test_promise_of_a_changed_parameter_is_the_fall_of_the_cost_of_its_fit(cart_log):
    system = Misread(0.19, 0.001)
    start, problem, reference = refitted(cart_log, system)
    known = catalogue(system)
    for name in ("changed(pole_mass)", "changed(length)"):
        cause = known[name]
        (point,) = screen(problem, reference, start.prior, [(cause, {})])
        prior = prior_with(problem, start, [cause], reference.values)
        fit = problem.fit_one(
            Trial(name, prior.names, prior, reference.values, reference.state, reference.nuisance)
        )
        assert point.promise == pytest.approx(reference.cost - fit.cost, rel=0.05, abs=0.5)


def test_parameter_to_which_another_cause_adds_is_left_out_of_the_screening(cart_log):
    system = CartPole()
    start, problem, reference = refitted(cart_log, system)
    known = catalogue(system)
    tried = [(known[n], {}) for n in ("viscous(cart)", "changed(cart_viscous)", "changed(length)")]
    found = screen(problem, reference, start.prior, tried)
    assert [p.cause.name for p in found] == ["viscous(cart)", "changed(length)"]


def test_effect_takes_over_what_the_refit_has_moved_the_parameter_to_which_it_adds(cart_log):
    system = CartPole()
    start, problem, reference = refitted(cart_log, system)
    known = catalogue(system)
    tried = [(known[n], {}) for n in ("viscous(cart)", "changed(cart_viscous)")]
    centre, moved = start.prior.centre.copy(), 0.2
    centre[start.prior.names.index("cart_viscous")] = reference.values["cart_viscous"] - moved
    far = Prior(start.prior.names, centre, start.prior.covariance)
    (point,) = screen(problem, reference, far, tried)
    assert point.values["viscous(cart).change"] == pytest.approx(moved)
    assert point.values["cart_viscous"] == pytest.approx(reference.values["cart_viscous"] - moved)
    # The motion is that of the refit, so its chi2 stays and the penalty of the parameter goes.
    there = problem.evaluate({**reference.values, **point.values}, state=reference.state)
    assert there.chi2 == pytest.approx(reference.chi2, rel=1e-6)


def test_new_value_says_factor_and_interval():
    text = new_value("servo_gain", 100.0, Estimate(200.0, 197.0, 203.0, "1"))
    assert text == "servo gain is 200, not 100 (x 2.00 [1.97, 2.03])"
    assert new_value("spring", 0.0, Estimate(0.5, 0.4, 0.6, "N m")) == "spring is 0.5 N m, not 0 N m"
    assert "(x" not in new_value("excess", 2.7e-37, Estimate(0.26, 0.2, 0.3, "1"))
    assert new_value("mass", 1.0, Estimate(2.0, 1.5, math.inf, "kg")).endswith("(x 2.00 [1.50, inf])")
    assert "x 1.0035 [1.0034, 1.0036]" in new_value("mass", 1.0, Estimate(1.0035, 1.0034, 1.0036, "kg"))


def test_changed_parameter_reads_names_with_brackets():
    assert changed_parameter("changed(damping(elbow))") == "damping(elbow)"
    assert changed_parameter("coulomb(joint 2)") is None
    assert spoken("changed(damping(elbow))") == "another value of damping (elbow)"


def test_what_is_far_off_is_told_on_a_machine_that_differs_a_little_in_everything(tmp_path):
    # No three new values explain this log, because five differ; one of them by 2.5 declared deviations.
    unit = CartPoleUnit(
        cart_mass=0.614, pole_mass=0.206, length=0.3035, cart_viscous=0.75, pole_viscous=0.0026
    )
    cart = load_system(CART)
    windows = cut_windows(read_logs(unit.log(tmp_path, seconds=10.0), cart), cart, 1.0)
    start = baseline_from(cart, windows)
    windows, found = refit_sharply(start, windows.take(moving(windows)))
    (moved,) = moved_parameters(FitProblem(start.system, windows), start, found)
    assert moved.name == "cart_viscous"
    assert moved.estimate.value == pytest.approx(0.75, rel=0.02)
    assert moved.prior_sds == pytest.approx(2.5, abs=0.2)


def test_of_two_parameters_whose_ratio_alone_shows_the_less_known_one_is_named():
    # The ball is 15 % heavier: 10 standard deviations of its mass, but 2.1 of the strength of its magnet.
    system, log = Maglev(), levitated_ball(0.075, 2.0)
    windows = cut_windows([log], system, 0.03)
    start = baseline_from(system, windows)
    windows, found = refit_sharply(start, windows.take(moving(windows)))
    (moved,) = moved_parameters(FitProblem(start.system, windows), start, found)
    assert moved.name == "magnet"
    assert moved.estimate.value == pytest.approx(6.5e-5 * 0.065 / 0.075, rel=2e-3)
    (other,) = moved.instead
    assert other.name == "mass"
    assert other.estimate.low < other.estimate.value < other.estimate.high
    assert other.estimate.value == pytest.approx(0.075, rel=2e-3)
    assert moved.to_json()["instead"][0]["name"] == "mass"
    assert "or instead mass is 75 g, not 65 g" in moved_value(moved)


@pytest.mark.parametrize(
    ("low", "high", "given", "expected"),
    [
        # By hand, 0.1 becomes 0.02, so the other becomes five times as large: 5 of 1, and 0.1 / 0.05 = 2 at least.
        (-0.01, 0.05, 1.0, (5.0, 2.0, 8.0)),
        (0.0, 0.05, 1.0, (5.0, 2.0, 8.0)),
        (-0.01, 0.05, -1.0, (-5.0, -8.0, -2.0)),
        (0.01, 0.05, 1.0, (5.0, 2.0, 8.0)),  # 0.1 / 0.01 = 10 is beyond its bound, too
        (0.0125, 0.05, 0.5, (2.5, 1.0, 4.0)),
    ],
)
def test_the_interval_of_an_inverse_holds_its_value_and_ends_at_the_bounds(low, high, given, expected):
    other = Parameter("magnet", given, "1", -8.0, 8.0, 0.1, "c")
    found = in_ratio(Estimate(0.02, low, high, "kg"), 0.1, other, given, -1)
    assert (found.value, found.low, found.high) == pytest.approx(expected)


def test_the_interval_of_an_equal_factor_may_cross_zero_and_ends_at_the_bounds():
    # 0.1 becomes 0.02 in [-0.01, 0.05]: of 10, that is 2 in [-1, 5], of which 0 to 4 is admissible.
    other = Parameter("length", 3.0, "m", 0.0, 4.0, 0.1, "l")
    found = in_ratio(Estimate(0.02, -0.01, 0.05, "kg"), 0.1, other, 10.0, 1)
    assert (found.value, found.low, found.high) == pytest.approx((2.0, 0.0, 4.0))


@pytest.mark.study
def test_a_window_of_a_few_samples_is_diagnosed():
    result = diagnose([levitated_ball(0.075)], Maglev(), only=["gain_drift"])
    assert result.verdict == "nothing"
    assert headline(result).startswith("magnet is")


class Motor(System):
    """A DC motor: its log shows K / (R J) and (K^2 / R + b) / J, two ratios of five parameters."""

    joint_units = "rad"
    parameters = (
        Parameter("constant", 0.05, "N m/A", 0.005, 0.5, 5e-4, "K"),
        Parameter("resistance", 2.0, "1", 0.2, 20.0, 0.04, "R"),
        Parameter("inertia", 2e-4, "kg m2", 1e-5, 2e-3, 3e-5, "J"),
        Parameter("viscous", 1e-4, "N m s/rad", 0.0, 1e-2, 1e-4, "b"),
    )
    commands = (Channel("voltage", "V", "command", -12.0, 12.0),)
    measurements = (Channel("angle", "rad", "measurement", noise_sd=1e-3),)

    def accelerations(self, p):
        def law(motion):
            per_volt = p["constant"] / p["resistance"]
            torque = per_volt * (motion.efforts[0] - p["constant"] * motion.speeds[0])
            return ((torque - p["viscous"] * motion.speeds[0] + motion.load(0)) / p["inertia"],)

        return law


def motor_log(constant: float, resistance: float, inertia: float, viscous: float) -> Recording:
    """Angle of a motor under random voltages, by the exact solution of its linear equation."""
    rng = np.random.default_rng(43200)
    voltage = np.repeat(rng.uniform(-6.0, 6.0, 100), 20)  # held for 0.2 s at 100 Hz
    gain = constant / (resistance * inertia)
    rate = (constant**2 / resistance + viscous) / inertia
    angle, speed, angles, fall = 0.0, 0.0, [], math.exp(-0.01 * rate)
    for u in voltage:
        angles.append(angle + 1e-3 * rng.standard_normal())
        end = gain * u / rate
        angle += 0.01 * end + (speed - end) * (1.0 - fall) / rate
        speed = end + (speed - end) * fall
    t = 0.01 * np.arange(len(voltage))
    measured = Series(t, np.array(angles), "rad", "measurement")
    return Recording({"voltage": Series(t, voltage, "V", "command"), "angle": measured})


@pytest.mark.parametrize("with_push", [False, True])
def test_of_pairs_that_explain_a_log_alike_the_likely_one_is_named(with_push):
    # The inertia is 2.3 deviations off and the others within one; the resistance would have to be 12 off. A push that
    # any unit may have can be part of the refit, and is no parameter of the system.
    windows = cut_windows([motor_log(0.0499, 2.015, 2.7e-4, 1.25e-4)], Motor(), 1.5)
    start = baseline_from(Motor(), windows)
    windows, found = refit_sharply(start, windows.take(moving(windows)))
    problem = FitProblem(start.system, windows)
    if with_push:
        prior = start.prior.widened(declared(problem, ["event.torque"]), start.values)
        trial = Trial("refit", prior.names, prior, found.values, found.state, found.nuisance)
        found = problem.fit_one(trial)
    names = [moved.name for moved in moved_parameters(problem, start, found)]
    assert "inertia" in names
    assert "resistance" not in names


class Carriage(System):
    """A carriage of 3.2 kg behind a motor; only viscous friction / mass and force / mass show in its motion."""

    joint_names, joint_units = ("carriage",), ("m",)
    parameters = (
        Parameter("mass", 3.2, "kg", 0.5, 20.0, 0.1, "m"),
        Parameter("force_constant", 24.0, "N/A", 2.0, 200.0, 0.72, "k"),
        Parameter("viscous", 8.0, "N s/m", 0.0, 100.0, 0.8, "b"),
    )
    commands = (Channel("current", "A", "command", -5.0, 5.0),)
    measurements = (Channel("x", "m", "measurement", noise_sd=1e-4),)

    def accelerations(self, p):
        def law(motion):
            force = p["force_constant"] * motion.efforts[0] - p["viscous"] * motion.speeds[0] + motion.load(0)
            return (force / p["mass"],)

        return law


def test_the_interval_of_a_new_value_counts_what_is_not_known_of_the_others():
    """Mass and force constant are 3 % below their values: the motion is that of 3.2 kg with a friction 3 % higher."""
    mass, force, viscous, step = 3.2 * 0.97, 24.0 * 0.97, 14.4, 0.01
    rng = np.random.default_rng(0)
    current = np.repeat(rng.uniform(-1.0, 1.0, 75), 20)
    decay = math.exp(-viscous / mass * step)
    x = v = 0.0
    shown = []
    for i in current:  # exact between two samples, because the command holds
        shown.append(x)
        steady = force * i / viscous
        x += steady * step + (v - steady) * (1.0 - decay) * mass / viscous
        v = steady + (v - steady) * decay
    t = np.arange(len(current)) * step
    measured = np.array(shown) + rng.normal(0.0, 1e-4, len(t))
    log = Recording(
        {
            "current": Series(t, current, "A", "command"),
            "x": Series(t, measured, "m", "measurement"),
        }
    )
    start, problem, found = refitted(log, Carriage())
    (moved,) = moved_parameters(problem, start, found)
    assert moved.name == "viscous"
    assert moved.estimate.value == pytest.approx(viscous / 0.97, rel=5e-3)
    assert moved.estimate.low < viscous < moved.estimate.high
    # The log ties mass and force constant, each known to about 3 %, to one scale: 3 % / sqrt(2) of it stays open.
    assert moved.estimate.high - moved.estimate.low == pytest.approx(
        2 * 1.96 * viscous * 0.0305 / math.sqrt(2), rel=0.15
    )
