"""Scale gauges of a motor: what multiplies out of the data is found, and one parameter fixes it."""

import numpy as np
import pytest
import torch

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from, with_gauges_fixed
from deepkoco.fit import fit
from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.fit_types import Fit
from deepkoco.fit.solve.gauges import Gauge, scale_gauges, text_of_gauges
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems.channel import Channel
from deepkoco.systems.joint import angle_channel
from deepkoco.systems.parameter import Parameter
from deepkoco.systems.system import System


class Motor(System):
    """J theta'' = K / R (u - K theta') - b theta': of K, R, J, b the log gives two numbers."""

    name, joint_units = "motor", ("rad",)
    commands = (Channel("voltage", "V", "command", -12.0, 12.0),)
    measurements = (angle_channel(0.001),)
    measured_states = (0,)
    load_scale = 0.3

    def __init__(self, spread=0.3) -> None:
        def own(name, value, unit, share=spread):
            return Parameter(name, value, unit, 0.01 * value, 100.0 * value, share * value, name)

        self.parameters = (
            own("constant", 0.05, "N m/A", 0.5 * spread),
            own("resistance", 2.0, "ohm"),
            own("inertia", 5e-4, "kg m2"),
            own("viscous", 2e-3, "N m s/rad"),
        )

    def ideal_measurement(self, state):
        return state[..., :1]

    def accelerations(self, parameters):
        p = parameters

        def acceleration(motion):
            (speed,), (voltage,) = motion.speeds, motion.efforts
            torque = (
                p["constant"] / p["resistance"] * (voltage - p["constant"] * speed) - p["viscous"] * speed
            )
            return ((torque + motion.load(0)) / p["inertia"],)

        return acceleration


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 8.0, 0.01)
    voltage = np.repeat(rng.uniform(-6.0, 6.0, 40), 20)
    gain, damping = 0.05 / 2.0 / 5e-4, (0.05**2 / 2.0 + 2e-3) / 5e-4
    angle, theta, omega = [], 0.0, 0.0
    for u in voltage:  # exact for a constant voltage
        angle.append(theta)
        steady, decay = gain * u / damping, np.exp(-0.01 * damping)
        theta += steady * 0.01 + (omega - steady) * (1.0 - decay) / damping
        omega = steady + (omega - steady) * decay
    shown = np.array(angle) + rng.normal(0.0, 0.001, len(t))
    return Recording(
        {"voltage": Series(t, voltage, "V", "command"), "theta": Series(t, shown, "rad", "measurement")}
    )


@pytest.fixture(scope="module")
def fixed(log):
    system = Motor()
    windows = cut_windows([log], system, 1.0)
    return with_gauges_fixed(baseline_from(system, windows), windows)


def test_four_constants_of_a_motor_have_two_gauges(fixed):
    # The log gives K / (R J) and (b + K^2 / R) / J.
    first, second = fixed.gauges
    assert first.fixed == "constant"
    known = {p.name: p.value for p in Motor().parameters}
    k2r = known["constant"] ** 2 / known["resistance"]
    total = k2r + known["viscous"]
    for gauge in (first, second):
        e = {n: gauge.exponents.get(n, 0.0) for n in known}
        assert e["constant"] - e["resistance"] - e["inertia"] == pytest.approx(0.0, abs=1e-3)
        friction = (2.0 * e["constant"] - e["resistance"]) * k2r + e["viscous"] * known["viscous"]
        assert friction / total - e["inertia"] == pytest.approx(0.0, abs=1e-3)
    assert "ohmmeter" in first.text or "ohmmeter" in second.text


def test_text_of_gauges_gives_powers_only_where_they_are_simple():
    simple = Gauge("mass", {"mass": 1.0, "gain": 0.5004}, "mass", "weigh it")
    odd = Gauge("mass", {"mass": 1.0, "gain": 0.645}, "mass", "weigh it")
    assert "gain c^0.5 times" in simple.text
    assert "c^" not in odd.text
    assert "weigh it" in odd.text


def test_text_of_several_gauges_asks_for_a_measurement_of_each():
    first = Gauge("mass(a)", {"mass(a)": 1.0, "gain": 0.3}, "mass(a)", "weigh it")
    second = Gauge("mass(b)", {"mass(b)": 1.0, "gain": 0.7}, "mass(b)", "weigh it")
    (text,) = text_of_gauges([first, second])
    assert text == (
        "The data give only ratios of mass(a), gain and mass(b). 2 measurements settle them: mass(a) and mass(b) "
        "(weigh each). Until then, mass(a) and mass(b) keep their values as given; the intervals count how "
        "well these are known."
    )
    assert text_of_gauges([]) == ()


def test_measurements_of_all_gauges_settle_all_parameters(fixed):
    names = list({n for gauge in fixed.gauges for n in gauge.exponents})
    measured = [names.index(gauge.measure) for gauge in fixed.gauges]
    ways = np.array([[gauge.exponents.get(n, 0.0) for gauge in fixed.gauges] for n in names])
    assert np.linalg.matrix_rank(ways[measured]) == len(fixed.gauges)


def test_fixed_parameter_keeps_its_value_and_the_others_get_ratios(fixed):
    sd = dict(zip(fixed.prior.names, np.sqrt(np.diag(fixed.prior.covariance)), strict=True))
    tight = {n for n, s in sd.items() if s < 1e-3 * fixed.values[n]}
    assert tight == {g.fixed for g in fixed.gauges}


def test_tight_priors_are_left_alone(log):
    system = Motor(spread=0.01)
    windows = cut_windows([log], system, 1.0)
    start = baseline_from(system, windows)
    assert with_gauges_fixed(start, windows) is start


def test_fit_reports_gauges_of_what_it_frees(log):
    found = fit([log], Motor(), ["constant", "inertia", "viscous"])
    (gauge,) = found.gauges
    assert set(gauge.exponents) == {"constant", "inertia", "viscous"}
    assert found.to_json()["scale_gauges"][0]["fixed"] == "constant"
    assert fit([log], Motor(), ["inertia", "viscous"]).gauges == ()


def test_diagnosis_says_which_measurement_settles_the_scale(log):
    result = diagnose([log], Motor(), window=1.0, only=["coulomb"])
    assert result.verdict == "nothing"
    assert len(result.unexplained["scale_gauges"]) == 2
    (advice,) = (text for text in result.advice if "only ratios" in text)
    assert "2 measurements settle them" in advice
    assert "ohmmeter" in advice
    assert torch.isfinite(torch.tensor(result.chi2_before))


def test_of_a_sum_the_small_part_is_kept_and_the_large_one_stays_free():
    # Only kv + damping shows: kv 1.1 (30 %), damping 0.07 (50 %). Kept as given, kv could not fall by a third.
    declared = (
        Parameter("kv", 1.1, "N m s/rad", 0.0, 10.0, 0.33, ""),
        Parameter("damping", 0.07, "N m s/rad", 0.0014, 10.0, 0.035, ""),
    )
    values = {p.name: p.value for p in declared}
    shown = np.full((2, 2), 1e8)
    none = torch.zeros(0)
    found = Fit("sum", ("kv", "damping"), values, shown, shown, none, none, 0.0, 0.0, none, shown)
    (gauge,) = scale_gauges(found, declared)
    assert gauge.fixed == "damping"


@pytest.mark.parametrize("seed", [0, 1, 32, 59, 62, 70, 94, 104])
def test_every_gauge_gets_a_measurement_although_some_parameters_hardly_take_part(seed):
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(7, 3)) * 10.0 ** rng.uniform(-2.0, 0.0, (7, 1))
    ways[4:] = np.eye(3)
    shown = 1e6 * (np.eye(7) - ways @ np.linalg.pinv(ways))
    declared = [Parameter(f"p{k}", 1.0, "kg", 0.0, 10.0, 0.01 if k > 3 else 1.0, "") for k in range(7)]
    none = torch.zeros(0)
    values = {p.name: 1.0 for p in declared}
    found = Fit("all", tuple(values), values, shown, shown, none, none, 0.0, 0.0, none, shown)
    gauges = scale_gauges(found, declared)
    assert len({g.measure for g in gauges}) == len(gauges) == 3


@pytest.mark.parametrize("seed", range(6))
def test_a_parameter_that_hardly_shows_hides_no_gauge(seed):
    # In relative changes, 1e6 of the weak one cancel 1 of the strong one; first and second show as their sum alone.
    rng = np.random.default_rng(seed)
    slopes = rng.normal(size=(5, 2)) @ np.array([[1.0, 1e-6, 0.0, 0.0], [0.3, 3e-7, 1.0, 1.0]])
    shown = 1e8 * slopes.T @ slopes
    names = ("strong", "weak", "first", "second")
    declared = [Parameter(n, 1.0, "kg", 0.0, 10.0, 0.3, "") for n in names]
    none = torch.zeros(0)
    found = Fit("all", names, dict.fromkeys(names, 1.0), shown, shown, none, none, 0.0, 0.0, none, shown)
    (gauge,) = (g for g in scale_gauges(found, declared) if "weak" not in g.exponents)
    assert gauge.exponents == pytest.approx({"first": 1.0, "second": -1.0}, rel=1e-6)
