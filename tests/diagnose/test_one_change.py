"""One changed parameter of a model file, told from a file that is rough in many: evidence in closed form, and logs."""

import mujoco
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from, with_gauges_fixed
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.data_sheet import with_usual_spread
from deepkoco.diagnose.evidence.priors import freed, prior_with
from deepkoco.diagnose.one_change import _evidence, one_change, outweighs_rough_file
from deepkoco.diagnose.refitted import refit_to_logs
from deepkoco.fit.data.windows import window_length
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_system

ROD = """
<mujoco model="rod"><option timestep="0.001" integrator="RK4"/>
<worldbody><body><joint name="hinge" axis="0 1 0" damping="{damping}" armature="0.02"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="{mass}"/></body></worldbody>
<actuator><motor name="push" joint="hinge" gear="{gear}"/></actuator></mujoco>
"""
GIVEN = {"damping": 0.1, "mass": 0.8, "gear": 2.0}
H = 0.01


def recorded(seed=0, **unit):
    rng = np.random.default_rng(seed)
    values = {name: value * (1.0 + 0.005 * rng.standard_normal()) for name, value in GIVEN.items()}
    values |= {name: factor * values[name] for name, factor in unit.items()}
    model = mujoco.MjModel.from_xml_string(ROD.format(**values))
    data, angle = mujoco.MjData(model), []
    t = np.arange(0.0, 16.0, H)
    effort = 0.5 * np.sin(2.1 * t) + 0.4 * np.sin(5.3 * t + 1.0)
    for u in effort:
        angle.append(float(data.qpos[0]))
        for _ in range(round(H / model.opt.timestep)):
            data.ctrl[:] = u
            mujoco.mj_step(model, data)
    noisy = np.array(angle) + 1e-3 * rng.standard_normal(len(t))
    return Recording(
        {"push": Series(t, effort, "N m", "command"), "q_hinge": Series(t, noisy, "rad", "measurement")}
    )


@pytest.fixture(scope="module")
def rod(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "rod.xml"
    path.write_text(ROD.format(**GIVEN))
    return load_system(path)


def changes(log, system):
    data = cut_data([log], [], system, window_length(system))
    base = refit_to_logs(with_gauges_fixed(baseline_from(system, data.train), data.train), data)
    return one_change(base, base.reference)


def test_evidence_is_that_of_a_normal_model():
    rng = np.random.default_rng(3)
    slopes, sds = rng.standard_normal((12, 4)), rng.uniform(0.1, 2.0, 4)
    y = slopes @ (sds * rng.standard_normal(4)) + rng.standard_normal(12)
    ours = _evidence(slopes.T @ slopes, slopes.T @ y, sds)
    whole, noise = np.eye(12) + (slopes * sds**2) @ slopes.T, np.eye(12)
    wanted = multivariate_normal.logpdf(y, cov=whole) - multivariate_normal.logpdf(y, cov=noise)
    assert ours == pytest.approx(wanted, abs=1e-9)


def test_a_parameter_that_a_guessed_prior_allows_is_found(rod):
    assert set(changes(recorded(damping=1.9), rod)) == {"damping(hinge)"}


def test_units_of_one_make_and_files_that_are_rough_in_many_values_have_none(rod):
    assert changes(recorded(), rod) == {}
    assert changes(recorded(damping=1.5, gear=0.85, mass=1.1), rod) == {}


def body_outweighs(log, system):
    """Whether a heavier body, fitted beside units of one make, outweighs a rough file."""
    data = cut_data([log], [], system, window_length(system))
    base = refit_to_logs(with_gauges_fixed(baseline_from(system, data.train), data.train), data)
    usual = with_usual_spread(base.start)
    cause = next(c for c in catalogue(system, regrouping=True).values() if c.name.startswith("body_mass"))
    fit = base.reference
    values = {**usual.values, **{n: fit.values.get(n, usual.values[n]) for n in cause.free}}
    for _ in range(2):  # the prior of a cause is as wide as the cause is large
        fit = base.problem.fit_one(freed(base.problem, usual, [cause], fit, values), 60)
        values = fit.values
    return outweighs_rough_file(
        base, fit, prior_with(base.problem, usual, [cause], fit.values), len(catalogue(system))
    )


def test_a_heavier_body_outweighs_a_rough_file_where_its_own_fit_ends(rod):
    # Seen by the slopes of a refit that has lightened everything else, it may lie beyond.
    assert body_outweighs(recorded(mass=1.5), rod)
    assert not body_outweighs(recorded(), rod)
    assert not body_outweighs(recorded(damping=1.5, gear=0.85, mass=1.1), rod)


@pytest.mark.study
@pytest.mark.long
def test_a_file_that_is_rough_in_many_values_lacks_nothing(rod):
    assert diagnose([recorded(damping=1.5, gear=0.85, mass=1.1)], rod).verdict == "nothing"


@pytest.mark.study
def test_it_is_named(rod):
    found = diagnose([recorded(damping=1.9)], rod)
    (finding,) = found.causes
    assert {"changed(damping(hinge))", "viscous"} & set(finding.members)


@pytest.mark.study
def test_a_healthy_rod_lacks_nothing(rod):
    assert diagnose([recorded()], rod).verdict == "nothing"
