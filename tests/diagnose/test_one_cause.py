"""One cause in a unit of a model file, told from a file that is rough in many values."""

import mujoco
import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from, with_gauges_fixed
from deepkoco.diagnose.causes import catalogue, shown_causes
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.one_cause import one_cause
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


def single(log, system):
    data = cut_data([log], [], system, window_length(system))
    base = refit_to_logs(with_gauges_fixed(baseline_from(system, data.train), data.train), data)
    return one_cause(base, shown_causes(catalogue(system, regrouping=True), ["q_hinge"]))


def test_a_parameter_that_a_guessed_prior_allows_is_found(rod):
    found = single(recorded(damping=1.9), rod)
    assert max(found, key=found.get) in ("changed(damping(hinge))", "viscous")


def test_a_heavier_body_is_found_although_its_mass_and_inertia_may_move_alone(rod):
    found = single(recorded(mass=1.5), rod)
    assert any(name.startswith(("body_mass", "payload")) for name in found)


def test_units_of_one_make_and_files_that_are_rough_in_many_values_have_none(rod):
    assert single(recorded(), rod) == {}
    assert single(recorded(damping=1.5, gear=0.85, mass=1.1), rod) == {}
