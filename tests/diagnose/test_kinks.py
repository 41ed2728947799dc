"""A limit that a servo does not reach: where a refit left it, and what the log tells of it."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from, with_gauges_fixed
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.evidence.kinks import without_kinks
from deepkoco.diagnose.refitted import refit_to_logs
from deepkoco.fit.data.windows import window_length
from deepkoco.fit.fit import Trial
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_system

SERVO = """
<mujoco model="servo"><option timestep="0.001" integrator="RK4"/>
<worldbody><body><joint name="hinge" axis="0 1 0" damping="0.3" armature="0.03"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.8"/></body></worldbody>
<actuator><position name="goal" joint="hinge" kp="{kp}" kv="1.5" forcerange="-{limit} {limit}"/></actuator></mujoco>
"""
LIMIT = "force_limit(goal)"
H = 0.01


def recorded(kp=28.0, limit=20.0):
    model = mujoco.MjModel.from_xml_string(SERVO.format(kp=kp, limit=limit))
    data, angle, most = mujoco.MjData(model), [], 0.0
    t = np.arange(0.0, 12.0, H)
    goal = 0.5 * np.sign(np.sin(2.0 * t)) * np.minimum(np.abs(4.0 * np.sin(2.0 * t)), 1.0)
    for u in goal:
        angle.append(float(data.qpos[0]))
        for _ in range(round(H / model.opt.timestep)):
            data.ctrl[:] = u
            mujoco.mj_step(model, data)
            most = max(most, abs(float(data.actuator_force[0])))
    noisy = np.array(angle) + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    log = Recording(
        {"goal": Series(t, goal, "rad", "command"), "q_hinge": Series(t, noisy, "rad", "measurement")}
    )
    return log, most


def servo(folder, limit):
    path = folder / "servo.xml"
    path.write_text(SERVO.format(kp=40.0, limit=limit))
    return load_system(path)


def refitted(log, system):
    data = cut_data([log], [], system, window_length(system))
    return refit_to_logs(with_gauges_fixed(baseline_from(system, data.train), data.train), data)


def test_a_limit_that_is_not_reached_is_as_given(tmp_path):
    log, most = recorded()
    base = refitted(log, servo(tmp_path, 20.0))
    assert base.reference.values[LIMIT] == pytest.approx(20.0)
    # A refit that came from small limits, and stopped where it meets the largest effort.
    prior, had = base.start.prior, base.reference
    at, small = prior.names.index(LIMIT), 0.85 * most  # reached so shortly that the log hardly shows it
    centre, covariance = prior.centre.copy(), prior.covariance.copy()
    centre[at], covariance[at, at] = small, 1e-6
    there = replace(prior, centre=centre, covariance=covariance)
    stopped = base.problem.fit_one(Trial("stopped", had.free, there, {**had.values, LIMIT: small}, had.state))
    own = stopped.free.index(LIMIT)
    assert (20.0 - stopped.values[LIMIT]) ** 2 * stopped.information[own, own] > 100.0
    found = without_kinks(base.problem, base.start, stopped)
    assert found.values[LIMIT] == pytest.approx(20.0)
    assert found.values["kp(goal)"] == pytest.approx(had.values["kp(goal)"], rel=1e-3)


def test_a_limit_that_is_reached_is_that_of_the_log(tmp_path):
    log, most = recorded(limit=2.0)
    assert most == pytest.approx(2.0)
    base = refitted(log, servo(tmp_path, 2.4))
    assert base.reference.values[LIMIT] == pytest.approx(2.0, rel=0.05)
    assert without_kinks(base.problem, base.start, base.reference) is base.reference
