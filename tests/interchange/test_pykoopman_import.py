"""Models of pykoopman 1.2.1, recorded by make_pykoopman_reference.py."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from deepkoco.interchange import from_matrices, from_pykoopman
from deepkoco.koopman.files.model_folder import read_model_folder, write_model_folder
from deepkoco.koopman.lifting.edmdc import TargetCost, fit_edmdc
from deepkoco.koopman.lifting.lifted_linear import LiftedModelError
from deepkoco.koopman.lifting.lifting import FunctionLifting, Identity, stack_history

REFERENCE = json.loads((Path(__file__).parent / "pykoopman_reference.json").read_text())
X, U = np.array(REFERENCE["x"]), np.array(REFERENCE["u"])
COST = TargetCost([1.0, 0.1], [0.0, 0.0], 0.1)


def recorded_model(name):
    """What pykoopman's fitted object shows, from the record."""
    case = REFERENCE["cases"][name]
    observables = type(name, (SimpleNamespace,), {})(**case["observables"])
    matrices = {k: np.array(case[k]) for k in "ABC"}
    return SimpleNamespace(observables=observables, **matrices), np.array(case["lifted"])


@pytest.mark.parametrize("name", sorted(REFERENCE["cases"]))
def test_a_fitted_model_is_taken_over_and_our_own_fit_agrees(name, tmp_path):
    theirs, lifted = recorded_model(name)
    model = from_pykoopman(theirs, COST, 0.05)
    stacked = stack_history(X, model.lifting.window)
    np.testing.assert_allclose(model.lifting(stacked[:5]), lifted, atol=1e-12)

    own = fit_edmdc([X], [U], model.lifting, COST, 0.05)
    z, a = model.lifting(stacked)[:-1], U[model.lifting.window - 1 : -1]
    ours = z @ own.transition.T + a @ own.inputs.T
    np.testing.assert_allclose(z @ theirs.A.T + a @ theirs.B.T, ours, atol=1e-6)

    write_model_folder(model, tmp_path / "m", {})
    loaded, _ = read_model_folder(tmp_path / "m")
    for one, other in zip(
        model.linearise(stacked, U[-len(stacked) :]),
        loaded.linearise(stacked, U[-len(stacked) :]),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)


def test_observables_of_an_unknown_kind_are_called_with_the_window_oldest_first():
    class Custom:
        n_input_features_, n_output_features_, n_consumed_samples = 2, 3, 1

        def transform(self, rows):  # as pykoopman's delays: rows in time
            return np.hstack((rows[1:], rows[1:, :1] - rows[:-1, :1]))

    a, b, c = np.eye(3), np.ones((3, 1)), np.eye(2, 3)
    model = from_pykoopman(SimpleNamespace(observables=Custom(), A=a, B=b, C=c), COST, 0.05)
    assert isinstance(model.lifting, FunctionLifting)
    history = model.make_history()
    history.push(np.array([1.0, 2.0]))
    np.testing.assert_array_equal(model.lifting(history.push(np.array([5.0, 6.0]))), [5, 6, 4])


def test_what_cannot_be_taken_over_is_named():
    with pytest.raises(LiftedModelError, match="not a fitted"):
        from_pykoopman(SimpleNamespace(observables=Identity(2)), COST, 0.05)
    with pytest.raises(LiftedModelError, match="A is complex"):
        from_matrices(Identity(2), 1j * np.eye(2), np.ones((2, 1)), np.eye(2), COST, 0.05)
    with pytest.raises(LiftedModelError, match="C has shape"):
        from_matrices(Identity(2), np.eye(2), np.ones((2, 1)), np.eye(3), COST, 0.05)
