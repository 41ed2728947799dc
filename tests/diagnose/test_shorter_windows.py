"""Detents that move a simulation by parts of their pitch: sought and named in short windows."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.causes.disturbance import _pitches
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.diagnose.verdict.shorter_windows import explains_all, shorter_request
from deepkoco.diagnose.window_choice import MUCH
from deepkoco.fit.data.windows import cut_windows, moving
from deepkoco.fit.fit import FitProblem
from deepkoco.systems import load_system
from tests.oracle.feeder import DETENT, PHASE, PITCH, feeder_log, model_file


@pytest.mark.parametrize("seed", [15, 16])
def test_the_pitch_is_sought_in_windows_in_which_the_response_is_linear(tmp_path, seed):
    system, log = load_system(model_file(tmp_path)), feeder_log(12.0, seed)
    windows = cut_windows([log], system, 1.5)
    windows = windows.take(moving(windows))
    start = baseline_from(system, windows)
    problem = FitProblem(start.system, windows)
    # A refit without detents makes up for them by friction, and is far from the log within 1.5 s.
    off = {**start.values, "mass(carriage)": 2.8, "frictionloss(carriage)": 2.5}
    (missing,) = missing_torque(problem, problem.evaluate(off))
    (found,) = _pitches(missing, float(np.ptp(log.channels["q_carriage"].value)))
    assert found["pitch"] == pytest.approx(PITCH, rel=5e-3)


@pytest.mark.study
@pytest.mark.long
def test_detents_of_a_feeder_are_named_with_their_pitch(tmp_path):
    found = diagnose([feeder_log()], load_system(model_file(tmp_path)))
    assert [cause.name for cause in found.causes] == ["cogging"]
    sizes = {name.partition(".")[2]: p.value for name, p in found.causes[0].parameters.items()}
    assert sizes["pitch"] == pytest.approx(PITCH, rel=1e-3)
    expected = DETENT * np.array([np.cos(PHASE), np.sin(PHASE)])
    np.testing.assert_allclose([sizes["sine"], sizes["cosine"]], expected, rtol=0.1)


@pytest.mark.parametrize(
    ("verdict", "left", "healthy", "asked"),
    [
        ("unknown", 2.0 * MUCH, None, True),
        ("unknown", 0.5 * MUCH, None, False),
        ("cause", 2.0 * MUCH, None, False),
        ("unknown", 2.0 * MUCH, "logs", False),  # they tell how well a simulation follows the unit
    ],
)
def test_shorter_windows_are_asked_where_much_is_left_and_nothing_is_named(
    tmp_path, verdict, left, healthy, asked
):
    system, log = load_system(model_file(tmp_path)), feeder_log(12.0)
    windows = cut_windows([log], system, 1.5)
    start = SimpleNamespace(tempering=1.0, floor=1.0, most_noise=lambda _: 1.2)
    base = SimpleNamespace(train=windows, start=start, learned=SimpleNamespace(healthy=healthy))
    final = SimpleNamespace(chi2=left * windows.samples)
    judgement = SimpleNamespace(verdict=verdict, midway=None, final=final)
    said = []
    request = DiagnosisRequest([log], system, None, 1.5, 0, 24.0, (), said.append, 0.0)
    shorter = shorter_request(request, SimpleNamespace(base=base), judgement)
    assert (shorter is not None) == asked == bool(said)
    if shorter is not None:
        assert shorter.length == 0.25 * 1.5
        assert shorter.data.train.length == pytest.approx(shorter.length, rel=0.05)


def test_what_is_named_on_shorter_windows_counts_only_where_it_leaves_noise():
    train = SimpleNamespace(samples=1000)
    base = SimpleNamespace(train=train, start=SimpleNamespace(most_noise=lambda _: 1.2))
    judgement = SimpleNamespace(verdict="cause", final=SimpleNamespace(chi2=1100.0))
    assert explains_all(SimpleNamespace(base=base), judgement)
    judgement.final.chi2 = 1300.0
    assert not explains_all(SimpleNamespace(base=base), judgement)
