"""Solvers on their own: what they refuse and how the registry names them."""

import numpy as np
import pytest

from deepkoco.planning import SolverError, UnknownSolverError
from deepkoco.planning.solvers import check_solver, make_box_solver, registry, solver_names
from deepkoco.planning.solvers.daqp_solver import DaqpBox
from deepkoco.planning.solvers.qpsolvers_solver import QpsolversBox

QPSOLVERS_WARNINGS = pytest.mark.filterwarnings(
    "ignore:Converted matrix:UserWarning", "ignore:The default value of raise_error"
)


def test_a_program_that_daqp_refuses_to_update_is_not_solved():
    solver = DaqpBox(-np.ones(2), np.ones(2), 1e-6)
    np.testing.assert_allclose(solver.solve(2.0 * np.eye(2), np.ones(2)), [-0.5, -0.5])
    with pytest.raises(SolverError, match="at update"):
        solver.solve(-np.eye(2), np.ones(2))
    np.testing.assert_allclose(solver.solve(4.0 * np.eye(2), np.ones(2)), [-0.25, -0.25])


@QPSOLVERS_WARNINGS
def test_what_another_solver_raises_is_a_solver_error():
    solver = QpsolversBox("osqp", -np.ones(2), np.ones(2))
    with pytest.raises(SolverError, match="osqp"):
        solver.solve(np.diag([-1.0, 1.0]), np.ones(2))
    with pytest.raises(SolverError, match="not finite"):
        solver.solve(np.full((2, 2), np.nan), np.ones(2))


@QPSOLVERS_WARNINGS
@pytest.mark.parametrize("name", solver_names("condensed"))
def test_a_start_anywhere_leads_to_the_same_solution(name):
    # min x'x + q'x, separable: x = -q / 2 clipped to [-1, 1]
    solver = make_box_solver(name, -np.ones(3), np.ones(3), 1e-9)
    hessian, gradient = 2.0 * np.eye(3), np.array([1.0, -5.0, 5.0])
    for start in (None, np.zeros(3), np.array([-1.0, 1.0, -1.0]), np.array([1.0, -1.0, 1.0])):
        if start is not None:
            solver.start_at(start)
        np.testing.assert_allclose(solver.solve(hessian, gradient), [-0.5, 1.0, -1.0], atol=1e-6)
    solver.restart()
    np.testing.assert_allclose(solver.solve(hessian, -gradient), [0.5, -1.0, 1.0], atol=1e-6)


def test_auto_is_the_fastest_solver_of_a_form():
    assert check_solver("auto", "condensed") == "daqp"
    assert check_solver("auto", "sparse") == "osqp"


def test_unknown_and_unfit_solvers_are_named():
    with pytest.raises(UnknownSolverError, match=r'"nope" is not installed.*daqp'):
        check_solver("nope", "condensed")
    with pytest.raises(UnknownSolverError, match=r'"daqp" takes no sparse problem.*osqp'):
        check_solver("daqp", "sparse")


def test_a_missing_optional_solver_names_its_extra(monkeypatch):
    monkeypatch.setattr(registry, "find_spec", lambda name: None if name == "piqp" else object())
    monkeypatch.setattr(registry.qpsolvers, "available_solvers", ["daqp", "osqp"])
    with pytest.raises(UnknownSolverError, match=r'pip install "piqp.*" "clarabel'):
        check_solver("piqp", "condensed")
