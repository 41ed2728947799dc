"""Lanes of finite differences, and the slopes that are made of them."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from deepkoco.fit.fit import FitProblem
from deepkoco.fit.request import make_request
from deepkoco.fit.solve.fine_steps import with_steps_cut
from deepkoco.fit.tangent import PARAMETER_STEP, POSITION_STEP, SPEED_STEP, Tangent, simulated
from tests.fit.identify_logs import rod_log


@pytest.fixture(scope="module")
def problem():
    request = make_request([rod_log(4.0, 0)], "rod_pendulum", ["mass", "viscous"])
    return request.problem()


def point(problem, **values: float) -> np.ndarray:
    known = {p.name: p.value for p in problem.system.parameters} | values
    return np.array([known.get(name, 0.0) for name in problem.names])


def test_each_lane_is_moved_in_one_parameter_or_state(problem):
    columns = np.array([problem.names.index(n) for n in ("viscous", "mass")])
    theta, state = point(problem), problem.windows.state
    tangent = Tangent.at(problem, theta, columns, state)
    assert len(tangent) == 5
    step = PARAMETER_STEP * problem.scale[columns]
    assert tangent.steps.tolist() == [*step, POSITION_STEP, SPEED_STEP]
    np.testing.assert_array_equal(tangent.theta[[0, 3, 4]], np.stack([theta] * 3))
    for lane, column in enumerate(columns, 1):
        moved = np.flatnonzero(tangent.theta[lane] != theta)
        assert moved.tolist() == [column]
        assert torch.equal(tangent.state[lane], state)
    for lane, (entry, size) in enumerate([(0, POSITION_STEP), (1, SPEED_STEP)], 3):
        torch.testing.assert_close(
            tangent.state[lane, :, entry] - state[:, entry], torch.full_like(state[:, 0], size)
        )
        assert torch.equal(tangent.state[lane, :, 1 - entry], state[:, 1 - entry])


def test_a_parameter_at_its_upper_bound_is_moved_down(problem):
    mass = problem.names.index("mass")
    tangent = Tangent.at(
        problem, point(problem, mass=problem.high[mass]), np.array([mass]), problem.windows.state
    )
    assert tangent.steps[0] < 0.0
    assert tangent.theta[1, mass] < problem.high[mass]


def test_slopes_of_a_linear_simulation_are_its_coefficients(problem):
    rng = np.random.default_rng(0)
    columns = np.array([problem.names.index(n) for n in ("mass", "viscous")])
    theta, state = point(problem, mass=problem.high[problem.names.index("mass")]), problem.windows.state
    tangent = Tangent.at(problem, theta, columns, state)
    by_parameter, by_state = (
        torch.from_numpy(rng.normal(size=len(theta))),
        torch.from_numpy(rng.normal(size=2)),
    )
    predicted = torch.from_numpy(tangent.theta) @ by_parameter
    predicted = (predicted[:, None] + tangent.state @ by_state)[:, :, None, None]
    weight = torch.full((len(state), 1, 1), 3.0, dtype=torch.float64)
    weighing = SimpleNamespace(weight=weight, whitened=lambda slopes: slopes)
    slopes = tangent.slopes(predicted, weighing)
    expected = 3.0 * torch.cat([by_parameter[columns], by_state])
    torch.testing.assert_close(slopes, expected[:, None, None, None].expand_as(slopes), rtol=1e-6, atol=1e-6)


def test_lanes_of_cut_steps_are_points_with_these_steps_and_differences_with_usual_ones(problem):
    cut = FitProblem(problem.system, with_steps_cut(problem.windows, 4))
    columns = np.array([problem.names.index(n) for n in ("mass", "viscous")])
    state = problem.windows.state
    points = [point(problem), point(problem, mass=1.1 * point(problem)[problem.names.index("mass")])]
    tangents = [
        Tangent.at(cut, points[0], columns, state),
        Tangent.at(cut, points[1], columns[:1], state, states=False),
        Tangent.at(cut, points[1], columns, state, states=False),
    ]
    nuisance = cut.nuisances.none()[None].repeat(3, 1)
    lanes = simulated(cut, tangents, nuisance)
    at = 0
    for tangent in tangents:
        none = cut.nuisances.none()[None].repeat(len(tangent), 1)
        own, exact = lanes[at : at + len(tangent)], cut.predict(tangent.theta, tangent.state, none)
        at += len(tangent)
        torch.testing.assert_close(own[0], exact[0], rtol=0.0, atol=1e-12)
        found, wanted = tangent.slopes(own, cut), tangent.slopes(exact, cut)
        for a, b in zip(found, wanted, strict=True):
            assert float((a - b).norm()) < 1e-2 * float(b.norm())
    assert at == len(lanes)
