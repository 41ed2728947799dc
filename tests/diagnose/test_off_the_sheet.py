"""A parameter that is several stated standard deviations off is the answer, and one within them is not."""

import numpy as np
import pytest

from deepkoco import Channel, Parameter, System
from deepkoco.diagnose import diagnose
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.report.text import headline
from deepkoco.logs.recording import Recording, Series
from tests.diagnose.test_changed_parameter import Misread
from tests.systems.cart_pole import POLE_MASS, cart_pole_log


@pytest.fixture(scope="module")
def log():
    return cart_pole_log(seed=4, seconds=12.0)


@pytest.mark.parametrize("sd", [0.016, 0.019])
def test_a_mass_that_is_over_four_stated_deviations_off_is_named(log, sd):
    # The fall of the BIC by the prior alone, 4.2^2 to 5^2 less the charge for a parameter, is no 24.
    result = diagnose([log], Misread(0.12, sd), only=["changed", "coulomb"])
    assert result.verdict == "cause"
    (cause,) = result.causes
    assert cause.name == "changed(pole_mass)"
    assert result.detection <= cause.delta_bic < DETECTION
    assert cause.parameters["pole_mass"].value == pytest.approx(POLE_MASS, rel=0.01)
    assert cause.probabilities["changed(pole_mass)"] > 0.5
    assert headline(result).startswith("pole mass is 0.2 kg, not 0.12 kg")


def test_a_mass_within_three_stated_deviations_is_no_cause_and_is_told(log):
    result = diagnose([log], Misread(0.12, 0.03), only=["changed", "coulomb"])
    assert result.verdict == "nothing"
    assert [m.name for m in result.moved] == ["pole_mass"]


def test_the_headline_says_what_a_refit_within_a_wide_prior_is_worth(log):
    result = diagnose([log], Misread(0.12, 0.2), only=["coulomb"])
    assert result.verdict == "nothing"
    assert result.moved == ()
    assert "once its own parameters are refitted: as given, its held-out error" in headline(result)


FRICTION, MASS, FORCE, VISCOUS = 7.0, 3.2, 24.0, 8.0  # of a carriage [N, kg, N/A, N s/m]


class Carriage(System):
    """A carriage on a rail whose maker states its dry friction."""

    joint_units = "m"
    parameters = (
        Parameter("mass", MASS, "kg", 0.5, 20.0, 0.1, "m"),
        Parameter("force_constant", FORCE, "N/A", 2.0, 200.0, 0.7, "k"),
        Parameter("viscous", VISCOUS, "N s/m", 0.0, 100.0, 1.5, "d"),
        Parameter("friction", 4.0, "N", 0.0, 40.0, 0.8, "rail"),
    )
    commands = (Channel("current", "A", "command", -5.0, 5.0),)
    measurements = (Channel("position", "m", "measurement", noise_sd=1e-5),)

    def dry_friction_limits(self, p):
        return (p["friction"],)

    def accelerations(self, p):
        def law(motion):
            force = p["force_constant"] * motion.efforts[0] - p["viscous"] * motion.speeds[0]
            force = force - p["friction"] * motion.direction(0, over=4e-4) + motion.load(0)
            return (force / p["mass"],)

        return law


class Rougher(Carriage):
    """The same with a friction stated that is one standard deviation off."""

    parameters = (
        *Carriage.parameters[:3],
        Parameter("friction", FRICTION + 0.8, "N", 0.0, 40.0, 0.8, "rail"),
    )


def carriage_log(seconds=12.0, rate=200.0, parts=100, line=1e-5, noise=0.4):
    """A log of an encoder that often rests between two of its lines, where its rounding is a constant error."""
    rng = np.random.default_rng(5)
    goal, x, v, shown, sent = 0.0, 0.0, 0.0, [], []
    for k in range(int(seconds * rate)):
        goal = rng.uniform(-0.3, 0.3) if k % 200 == 0 else goal
        shown.append(line * np.round((x + noise * line * rng.normal()) / line))
        current = float(np.clip(60.0 * (goal - x) - 4.0 * v, -3.0, 3.0))
        sent.append(current)
        h = 1.0 / rate / parts
        for _ in range(parts):
            pushed = v + h * (FORCE * current - VISCOUS * v) / MASS
            after = np.sign(pushed) * max(abs(pushed) - h * FRICTION / MASS, 0.0)
            x += h * 0.5 * (v + after)
            v = after
    t = np.arange(len(shown)) / rate
    return Recording(
        {
            "position": Series(t, np.array(shown), "m", "measurement"),
            "current": Series(t, np.array(sent), "A", "command"),
        }
    )


@pytest.fixture(scope="module", params=[0.4, 0.05], ids=["white", "constant at rest"])
def rounded(request):
    return carriage_log(noise=request.param)


def test_a_friction_far_from_what_is_stated_is_named_however_an_encoder_rounds(rounded):
    # 3.75 stated deviations are a fall of 14. A deflation of nine would leave two of it.
    result = diagnose([rounded], Carriage(), only=["changed", "coulomb"])
    assert result.verdict == "cause"
    assert "friction is" in headline(result)
    (cause,) = result.causes
    value = cause.parameters.get("friction") or cause.same_as[0].estimate
    assert value.low <= FRICTION <= value.high
    assert value.value == pytest.approx(FRICTION, rel=0.05)


def test_a_friction_as_stated_is_no_cause_however_an_encoder_rounds(rounded):
    result = diagnose([rounded], Rougher(), only=["changed", "coulomb"])
    assert result.verdict == "nothing"
    # The scale is told by what is stated alone, so each value is known no worse than that.
    for name, sd in (("mass", 0.1), ("force_constant", 0.7), ("friction", 0.8)):
        assert result.refit[name].high - result.refit[name].low <= 1.01 * 2.0 * 1.96 * sd
