"""Causes that add nothing to a learned load are no names; right ones that leave a model error are."""

import pytest

from deepkoco.diagnose.baseline import baseline_from, with_gauges_fixed
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.evidence.footholds import trial_of
from deepkoco.diagnose.evidence.residual_model import learn_residual
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.refitted import refit_to_logs
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.diagnose.verdict.beside_load import idle_beside
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log

SHAPE = {
    "position_friction": {"size": 0.1}
}  # a damping that changes with the angle: no cause of the catalogue


@pytest.mark.study
@pytest.mark.parametrize(
    ("hidden", "name", "idle"),
    [(SHAPE, "asymmetry", True), ({**SHAPE, "coulomb": {"torque": 0.15}}, "coulomb", False)],
)
def test_a_cause_that_a_learned_load_replaces_is_no_name(hidden, name, idle):
    system = make_system("rod_pendulum")
    data = cut_data([hidden_log("rod_pendulum", hidden, "steps", 5, 20.0)], (), system, 1.6)
    base = refit_to_logs(with_gauges_fixed(baseline_from(system, data.train), data.train), data)
    cause, reference = catalogue(system)[name], base.reference
    at = {**reference.values, **{n: base.start.system.parameter(n).prior_sd for n in cause.sizes}}
    trial = trial_of(base.problem, base.start, (), cause, at, reference.state, reference)
    fit = base.problem.fit([trial], 40)[0]
    assert fit.chi2 > base.start.most_noise(base.train) * base.train.samples  # it leaves structure
    learned = learn_residual(
        base.start, base.train, base.held, reference, missing_torque(base.problem, reference), 0
    )
    assert learned is not None
    found = Selected(fit, (cause,), ((None, (name,)),), base.problem)  # pyright: ignore[reportArgumentType]
    told = idle_beside(base, found, learned, 0)
    assert (told is not None) == idle
    if told is not None:
        assert name in told
