"""A load on a link where the refit has moved the link's own mass and centre of mass instead."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from deepkoco import load_system
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.curved_valley import cheapest_in_valley
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.fit import FitProblem, Trial, cut_windows
from deepkoco.logs.recording import Recording, Series

ARM = """<mujoco><option timestep="0.001" integrator="RK4"/><compiler angle="radian"/><worldbody>
<body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="0.5" armature="0.05"/>
<inertial pos="0 0 -0.16" mass="2.4" diaginertia="0.026 0.027 0.004"/>
<body name="lower" pos="0 0 -0.34"><joint name="elbow" axis="0 1 0" damping="0.2" armature="0.02"/>
<inertial pos="0 0 -0.14" mass="1.1" diaginertia="0.0092 0.009 0.0009"/></body></body></worldbody>
<actuator><motor name="m1" joint="shoulder"/><motor name="m2" joint="elbow"/></actuator></mujoco>"""
LOAD, PLACE = 0.5, 0.3  # kg, and m from the elbow


@pytest.fixture(scope="module")
def refitted(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(ARM)
    spec = mujoco.MjSpec.from_string(ARM)
    load = spec.body("lower").add_body(name="load", pos=[0.0, 0.0, -PLACE])
    load.mass, load.inertia, load.explicitinertial, load.ipos = LOAD, [1e-8] * 3, True, [0.0] * 3
    model = spec.compile()
    data, rng = mujoco.MjData(model), np.random.default_rng(3)
    phase, rate = rng.uniform(0.0, 6.0, (2, 3)), rng.uniform(1.0, 6.0, (2, 3))
    rows = []
    for k in range(800):
        goal = 0.4 * np.sin(rate * 0.01 * k + phase).sum(1)
        torque = np.round([40.0, 15.0] * (goal - data.qpos) - [6.0, 2.0] * data.qvel, 6)
        rows.append((0.01 * k, *torque, *(data.qpos + 1e-4 * rng.standard_normal(2))))
        data.ctrl[:] = torque
        mujoco.mj_step(model, data, 10)
    t, *columns = np.array(rows).T
    names, kinds = ("m1", "m2", "q_shoulder", "q_elbow"), ("command", "command", "measurement", "measurement")
    units = ("N m", "N m", "rad", "rad")
    log = Recording({n: Series(t, x, u, k) for n, x, u, k in zip(names, columns, units, kinds, strict=True)})
    system = load_system(str(path))
    windows = cut_windows([log], system, 0.5)
    start = baseline_from(system, windows)
    return (start, *refit_sharply(start, windows))


def test_a_load_is_found_at_the_motion_of_a_refit_that_needs_none(refitted):
    start, windows, reference = refitted
    problem, cause = FitProblem(start.system, windows), catalogue(start.system.base)["payload"]
    assert reference.penalty > 20.0  # the refit imitates the load
    (point,) = cheapest_in_valley(problem, reference, start.prior, [cause])
    assert point.values["payload.mass"] == pytest.approx(LOAD, rel=0.05)
    assert point.values["payload.along"] == pytest.approx(PLACE, rel=0.05)
    # The motion is that of the refit; only the penalty of its parameters goes.
    values = {**reference.values, **point.values}
    chi2 = float(problem.fit_states(values, reference.state)[1].sum())
    assert chi2 == pytest.approx(reference.chi2, abs=0.5)
    prior = prior_with(problem, start, [cause], point.values)
    fit = problem.fit([Trial("payload", prior.names, prior, values, reference.state, reference.nuisance)], 6)[
        0
    ]
    assert reference.cost - fit.cost == pytest.approx(point.promise, rel=0.1)


def test_a_refit_near_its_prior_leaves_nothing_for_a_load(refitted):
    start, windows, reference = refitted
    problem, cause = FitProblem(start.system, windows), catalogue(start.system.base)["payload"]
    near = replace(reference, penalty=1.0)
    assert cheapest_in_valley(problem, near, start.prior, [cause]) == []
