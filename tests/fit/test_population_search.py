"""cma_es and Box against the package `cma`, and CMA-ES as a method of the fit."""

import builtins
import importlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.fit import CmaEs, MissingExtraError, cma_es, fit
from deepkoco.fit.solve.cma import Box
from tests.fit.identify_logs import DELAY, MASS, pendulum_log, rod_log

cma = pytest.importorskip("cma")
WIDE = np.full(4, np.inf)


def batched(function):
    return lambda points: np.array([function(point) for point in points])


@pytest.mark.parametrize("name", ["sphere", "elli", "rosen"])
def test_cma_es_solves_reference_problems(name):
    found = cma_es(
        batched(getattr(cma.ff, name)),
        np.full(4, 0.3),
        np.full(4, 0.5),
        -WIDE,
        WIDE,
        np.random.default_rng(0),
        tolerance=1e-12,
    )
    assert found.cost < 1e-9
    optimum = np.ones(4) if name == "rosen" else np.zeros(4)
    assert found.best == pytest.approx(optimum, abs=1e-4)
    assert found.converged


def test_cma_es_repeats_the_library_without_bounds():
    draws = np.random.default_rng(5)
    options = {
        "verbose": -9,
        "maxiter": 20,
        "randn": lambda *shape: draws.standard_normal(shape),
        "seed": np.nan,
    }
    theirs = cma.CMAEvolutionStrategy([0.0] * 4, 1.0, options)
    while not theirs.stop():
        points = theirs.ask()
        theirs.tell(points, [cma.ff.rosen(0.3 + 0.5 * p) for p in points])
    ours = cma_es(
        batched(cma.ff.rosen),
        np.full(4, 0.3),
        np.full(4, 0.5),
        -WIDE,
        WIDE,
        np.random.default_rng(5),
        generations=20,
        tolerance=0.0,
    )
    assert ours.cost == pytest.approx(theirs.result.fbest, rel=1e-12)
    assert ours.reason == "maxiter"


@given(
    st.lists(st.tuples(st.floats(-50, 50), st.floats(1e-3, 100)), min_size=1, max_size=4), st.integers(0, 99)
)
@settings(max_examples=40, deadline=None)
def test_box_folds_like_the_library(bounds, seed):
    low = np.array([b[0] for b in bounds])
    high = low + [b[1] for b in bounds]
    theirs = cma.transformations.BoxConstraintsLinQuadTransformation(list(zip(low, high, strict=True)))
    box, points = Box(low, high), np.random.default_rng(seed).normal(0.0, 60.0, (20, len(low)))
    assert box.fold(points) == pytest.approx(np.array([theirs(p) for p in points]), rel=1e-9, abs=1e-9)
    inside = np.random.default_rng(seed).uniform(low, high)
    assert box.fold(box.inverse(inside)) == pytest.approx(inside, rel=1e-9, abs=1e-9)
    assert box.inverse(inside) == pytest.approx(theirs.inverse(inside), rel=1e-6, abs=1e-6)


def test_box_with_one_bound_folds_one_side_only():
    box = Box(np.array([0.0, -np.inf]), np.array([np.inf, np.inf]))
    points = np.array([[-3.0, -3.0], [0.0, 1e6], [7.0, 2.0]])
    assert (box.fold(points)[:, 1] == points[:, 1]).all()
    # 3 below a bound at 0 with its margin of 0.05: 0.05 + (3 - 0.05) beyond the reflection point, less 0.05.
    assert box.fold(points)[:, 0] == pytest.approx([2.9, 0.0125, 7.0])


def test_cma_es_repeats_the_library_within_bounds():
    low, high, start, spread = np.full(3, -0.2), np.full(3, 0.9), np.full(3, 0.3), np.full(3, 0.5)
    draws = np.random.default_rng(5)
    options = {
        "verbose": -9, "maxiter": 25, "randn": lambda *shape: draws.standard_normal(shape), "seed": np.nan,
        "bounds": [((low - start) / spread).tolist(), ((high - start) / spread).tolist()],
    }  # fmt: skip
    theirs = cma.CMAEvolutionStrategy([0.0] * 3, 1.0, options)
    while not theirs.stop():
        points = theirs.ask()
        theirs.tell(points, [cma.ff.rosen(0.3 + 0.5 * p) for p in points])
    args = (batched(cma.ff.rosen), start, spread, low, high, np.random.default_rng(5))
    ours = cma_es(*args, generations=25, tolerance=0.0)
    assert ours.cost == pytest.approx(theirs.result.fbest, rel=1e-9)


def test_cma_es_keeps_bounds_and_repeats_by_seed_without_global_draws():
    seen = []

    def cost(points):
        seen.append(points)
        return ((points - 2.0) ** 2).sum(1)

    np.random.seed(3)  # noqa: NPY002 - the global state that must stay alone
    expected = np.random.random(3)  # noqa: NPY002
    np.random.seed(3)  # noqa: NPY002
    args = (np.zeros(2), np.ones(2), np.full(2, -1.0), np.array([1.0, np.inf]))
    first = cma_es(cost, *args, np.random.default_rng(1))
    assert np.random.random(3) == pytest.approx(expected)  # noqa: NPY002
    again = cma_es(cost, *args, np.random.default_rng(1))
    assert (first.best == again.best).all()
    assert first.best == pytest.approx([1.0, 2.0], abs=1e-3)
    assert np.concatenate(seen)[:, 0].max() <= 1.0


def test_cma_es_tolerates_points_without_finite_cost():
    def cost(points):
        return np.where(points[:, 0] < 0, np.nan, ((points - 0.5) ** 2).sum(1))

    found = cma_es(
        cost,
        np.full(2, 0.1),
        np.ones(2),
        np.full(2, -np.inf),
        np.full(2, np.inf),
        np.random.default_rng(0),
    )
    assert found.best == pytest.approx([0.5, 0.5], abs=1e-2)


@pytest.mark.study
def test_cma_es_fit_matches_levenberg_marquardt():
    asked = ["mass", "actuation_delay.delay"]
    bounds = {"mass": (0.03, 0.1), "actuation_delay.delay": (0.0, 0.05)}
    log = pendulum_log(5.0)
    smooth = fit([log], "pendulum", asked, bounds=bounds)
    found = fit([log], "pendulum", asked, bounds=bounds, method=CmaEs(population=12, generations=25))
    for name, true in zip(asked, (MASS, DELAY), strict=True):
        estimate = found.estimates[name]
        assert estimate.value == pytest.approx(smooth.estimates[name].value, abs=0.5 * estimate.sd)
        assert estimate.sd == pytest.approx(smooth.estimates[name].sd, rel=0.1)
        assert estimate.value == pytest.approx(true, rel=0.03)
    assert found.convergence.stages[0][1][-1] < found.convergence.stages[0][1][0]


@pytest.mark.study
def test_cma_es_fit_with_varies_matches_levenberg_marquardt():
    logs = [rod_log(4.0, seed=k, viscous=v) for k, v in enumerate((0.01, 0.05), start=1)]
    options = {"varies": {"viscous": 0.03}, "bounds": {"viscous": (0.0, 0.2)}}
    smooth = fit(logs, "rod_pendulum", ["viscous"], **options)
    method = CmaEs(population=12, generations=40)
    found = fit(logs, "rod_pendulum", ["viscous"], method=method, **options)
    for a, b in zip(found.of_logs, smooth.of_logs, strict=True):
        assert a.value == pytest.approx(b.value, abs=b.sd)
        assert a.sd == pytest.approx(b.sd, rel=0.1)


def test_cma_es_names_the_extra_of_a_missing_library(monkeypatch):
    real = importlib.import_module
    monkeypatch.setattr(
        "deepkoco.fit.solve.cma.import_module",
        lambda name: (_ for _ in ()).throw(builtins.ImportError(name)) if name == "cma" else real(name),
    )
    with pytest.raises(MissingExtraError, match=r'pip install "cma'):
        cma_es(batched(np.sum), np.zeros(1), np.ones(1), np.zeros(1), np.ones(1), np.random.default_rng(0))


def test_a_search_for_one_number_grows_up_to_its_bounds():
    """The way to the optimum is thirty deviations long, so the deviation grows beyond a third of the box."""
    search = cma_es(
        lambda points: 1e3 * np.abs(points[:, 0] - 0.9),
        np.array([0.1]),
        np.array([0.01]),
        np.array([0.0]),
        np.array([1.0]),
        generator=np.random.default_rng(0),
        population=16,
        generations=60,
    )
    assert search.best[0] == pytest.approx(0.9, abs=1e-3)
