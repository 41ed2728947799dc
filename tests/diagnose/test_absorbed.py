"""What a refit takes up by a parameter is explained by the cause that does the same."""

from dataclasses import replace

import numpy as np
import pytest
from test_weighed import XML

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.evidence.absorbed import absorbed, alike, refit_without
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.fit.data.windows import cut_windows, moving
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_system
from deepkoco.systems.trees.mujoco_library import mujoco_library

mujoco = mujoco_library()
DAMPING, HIDDEN = 0.05, 0.2  # as the file states it, and beside it [N m s/rad]
EXTRA = "viscous.change"


def log_of(hidden):
    model = mujoco.MjModel.from_xml_string(XML)
    model.dof_damping[0] += hidden
    data, rng = mujoco.MjData(model), np.random.default_rng(20_031)
    t, shown = np.arange(600) / 100.0, []
    sent = np.repeat(rng.uniform(-1.6, 1.6, 20), 30)
    for command in sent:
        shown.append(data.qpos[0] + 2e-4 * rng.standard_normal())
        data.ctrl[0] = command
        mujoco.mj_step(model, data, round(0.01 / model.opt.timestep))
    q = Series(t, np.array(shown), "rad", "measurement")
    return Recording({"motor": Series(t, sent, "N m", "command"), "q_hinge": q})


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    path = tmp_path_factory.mktemp("link") / "link.xml"
    path.write_text(XML)
    system = load_system(path)
    windows = cut_windows([log_of(HIDDEN)], system, 1.0)
    start = baseline_from(system, windows)
    windows, refit = refit_sharply(start, windows.take(moving(windows)))
    problem = FitProblem(start.system, windows)
    cause = catalogue(system)["viscous"]
    values = {**refit.values, "damping(hinge)": DAMPING, EXTRA: refit.values["damping(hinge)"] - DAMPING}
    prior = prior_with(problem, start, [cause], values)
    fit = problem.fit_one(Trial("viscous", prior.names, prior, values, refit.state, refit.nuisance))
    return start, problem, refit, cause, fit


def test_the_parameter_that_a_friction_adds_to_does_the_same(rubbing):
    start, problem, _, cause, fit = rubbing
    assert list(alike(problem, fit, cause, start.values)) == ["damping(hinge)"]


def test_a_refit_that_moved_it_far_has_taken_the_friction_up(rubbing):
    start, problem, refit, cause, fit = rubbing
    assert absorbed(problem, start, refit, [cause], fit) == ["damping(hinge)"]
    without = refit_without(problem, start, refit, ["damping(hinge)"], 40)
    assert without.values["damping(hinge)"] == DAMPING
    # Everything else of the same scale makes up for it, far from its prior.
    assert without.cost - refit.cost > 100.0


def test_a_parameter_near_its_prior_is_left_out(rubbing):
    start, problem, refit, cause, fit = rubbing
    near = replace(refit, values=start.values)
    assert absorbed(problem, start, near, [cause], fit) == []
