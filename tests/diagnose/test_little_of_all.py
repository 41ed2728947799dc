"""A little of every small effect, as any unit has it, beside named causes."""

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.data_sheet import with_usual_spread
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.little_of_all import beside
from deepkoco.fit import cut_windows
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_system
from deepkoco.systems.trees.mujoco_library import mujoco_library

mujoco = mujoco_library()

XML = """<mujoco model="link"><option timestep="0.0005" integrator="RK4"/><worldbody><body name="link">
  <joint name="hinge" type="hinge" axis="0 1 0" damping="0.02" armature="0.002"/>
  <inertial pos="0 0 -0.15" mass="0.8" diaginertia="0.006 0.006 0.0001"/></body></worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-2 2"/></actuator></mujoco>"""
DAMPING, NOISE = 0.1, 2e-5


def log_of(bias: float, seconds=5.0, rate=100.0, seed=3, skew=0.0) -> Recording:
    """A log of MuJoCo's own motion with more damping and a small constant load [N m]; its encoder's clock may gain."""
    model = mujoco.MjModel.from_xml_string(XML)
    model.dof_damping[0] += DAMPING
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    sent, shown, wanted = [], [], 0.0
    for i in range(round(seconds * rate)):
        if i % 20 == 0:
            wanted = float(rng.uniform(-0.8, 0.8))
        sent.append(wanted)
        shown.append(data.qpos[0] + NOISE * rng.standard_normal())
        data.ctrl[0] = wanted
        data.qfrc_applied[0] = bias
        mujoco.mj_step(model, data, round(1.0 / (rate * model.opt.timestep)))
    t = np.arange(len(sent)) / rate
    return Recording(
        {
            "motor": Series(t, np.array(sent), "N m", "command"),
            "q_hinge": Series(t * (1.0 + skew), np.array(shown), "rad", "measurement"),
        }
    )


def fitted_beside(folder, log, small):
    """Baseline and fit with more damping, beside a little of what these names say, and the fit without the little."""
    (folder / "link.xml").write_text(XML)
    system = load_system(folder / "link.xml")
    windows = cut_windows([log], system, 1.0)
    start = with_usual_spread(baseline_from(system, windows))
    causes = catalogue(start.system.base)
    damping = causes["viscous"]
    problem = FitProblem(start.system, windows)
    state, _ = problem.fit_states(start.values, windows.state)
    given = {**start.values, damping.free[0]: 0.07}
    prior = prior_with(problem, start, [damping], given)
    alone = problem.fit_one(
        Trial("alone", prior.names, prior, given, state, problem.evaluate(given).nuisance)
    )
    little = [damping, *(causes[n] for n in small if n in causes)]
    return start, alone, *beside(problem, start, alone, [damping], little), windows.samples, damping.free[0]


@pytest.mark.parametrize("bias", [0.0, 0.03])
def test_a_named_cause_is_fitted_with_the_little_that_the_windows_show(tmp_path, bias):
    small = ("torque_bias", "constant_load", "quadratic", "lag", "sensor_bias")
    start, alone, grown, fit, samples, damping = fitted_beside(tmp_path, log_of(bias), small)
    # A log of one motor tells loads up to a common factor, which is known to 2 %.
    assert fit.values[damping] == pytest.approx(DAMPING, rel=0.04)
    assert fit.chi2 / samples == pytest.approx(1.0, abs=0.2)
    shown = set(grown.prior.names) - set(start.prior.names)
    if bias:
        assert alone.chi2 / samples > 1.5
        load = sum(v for n, v in fit.values.items() if n in ("torque_bias.effort", "constant_load.load"))
        assert load == pytest.approx(bias, rel=0.1)
        assert shown
    else:
        # Nothing is shown: the cause is as well without.
        assert alone.chi2 - fit.chi2 < 0.1 * samples


def test_a_clock_that_gains_far_less_than_clocks_may_is_kept_where_it_shows(tmp_path):
    small = ("clock_skew", "quadratic", "sensor_bias")
    _, alone, grown, fit, samples, _ = fitted_beside(tmp_path, log_of(0.0, skew=5e-5), small)
    assert alone.chi2 / samples > 1.5
    assert "clock_skew" in grown.effects
    assert fit.values["clock_skew.rate"] == pytest.approx(5e-5, rel=0.1)
    assert fit.chi2 / samples == pytest.approx(1.0, abs=0.2)
