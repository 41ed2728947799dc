"""Sanity checks of estimates at bounds, driving friction, command sizes and flexible causes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from deepkoco.diagnose.baseline import Healthy, baseline_from
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.evidence.sanity_checks import (
    at_bound,
    doubts_of_bending,
    doubts_of_commands,
    doubts_of_estimates,
    doubts_of_friction,
)
from deepkoco.diagnose.residuals.residuals import white_limit
from deepkoco.fit.data.windows import CommandSeries
from deepkoco.fit.fit import FitProblem
from deepkoco.logs.recording import LogError, read_log
from deepkoco.systems import make_system
from tests.oracle.unit import hidden_log

BASE = make_system("rod_pendulum")


@pytest.fixture(scope="module")
def windows():
    return cut_data([hidden_log("rod_pendulum", {}, "steps", 172, 10.0)], (), BASE, 1.6).train


@pytest.mark.parametrize(
    ("factor", "doubted"), [(1.0, 0), (1e-3, 0), (1e3, 0), (1e-6, 1), (1e6, 1), (0.0, 0)]
)
def test_doubts_of_commands_are_raised_for_commands_that_no_unit_explains(windows, factor, doubted):
    scaled = tuple(CommandSeries(c.t, factor * c.value) for c in windows.commands)
    found = doubts_of_commands(replace(windows, commands=scaled), BASE)
    assert len(found) == doubted
    assert all('"torque"' in text and "N m" in text for text in found)


def test_doubts_of_estimates_are_raised_at_a_bound_but_not_at_null(windows):
    start = baseline_from(BASE, windows)
    problem = FitProblem(start.system, windows)
    null = problem.evaluate(start.values)
    known = catalogue(BASE)

    def moved(**values):
        return replace(null, values={**null.values, **{k.replace("__", "."): v for k, v in values.items()}})

    gain, zone = known["gain"], known["dead_zone"]
    assert at_bound(problem, gain, moved(gain__factor=10.0)) == ("gain.factor",)
    assert at_bound(problem, gain, moved(gain__factor=9.9)) == ()
    assert at_bound(problem, zone, null) == ()  # its null value is a bound
    # Below its lowest speed a Stribeck friction is a Coulomb friction, above its highest one nearly so.
    stribeck = known["stribeck"]
    for speed in (0.05, 20.0):
        fit = moved(stribeck__coulomb=0.1, stribeck__breakaway=0.1, stribeck__speed=speed)
        assert at_bound(problem, stribeck, fit) == ("stribeck.speed",)
    text = doubts_of_estimates(problem, [gain, zone], moved(gain__factor=-3.0))
    assert len(text) == 1
    assert "gain" in text[0]
    assert "-3" in text[0]
    # A parameter of the system has no effect in its name.
    mass = known["changed(mass)"]
    high = float(problem.high[problem.names.index("mass")])
    assert at_bound(problem, mass, moved(mass=high)) == ("mass",)
    assert "its mass stops at the bound" in doubts_of_estimates(problem, [mass], moved(mass=high))[0]


def residuals_like(windows, fit, chi2, colour=0.0):
    """A fit that leaves Gaussian residuals of this chi2 per sample, correlated along every channel."""
    rng = np.random.default_rng(1)
    drawn = rng.standard_normal(windows.value.shape)
    for k in range(1, drawn.shape[-1]):
        drawn[..., k] = colour * drawn[..., k - 1] + (1.0 - colour**2) ** 0.5 * drawn[..., k]
    residual = torch.from_numpy(drawn) * windows.valid
    residual = residual * (chi2 * windows.samples / (residual**2).sum()) ** 0.5
    return replace(fit, residual=residual, chi2=float((residual**2).sum()))


def test_doubts_of_bending_are_raised_where_flexible_causes_leave_more_than_noise(windows):
    start = baseline_from(BASE, windows)
    null = FitProblem(start.system, windows).evaluate(start.values)
    known, lost = catalogue(BASE), SimpleNamespace(name="lost_commands")
    below, above = (residuals_like(windows, null, white_limit(windows, deviations=sd)) for sd in (1.9, 2.1))
    coloured = residuals_like(windows, null, 1.0, 0.2)
    healthy = Healthy((), windows, start, (), coloured)
    for names, missing in ((["event", "coulomb"], None), (["coulomb"], lost), ([], lost)):
        causes = [known[n] for n in names]

        def doubts(fit, start=start, causes=causes, missing=missing):
            return doubts_of_bending(start, causes, missing, windows, fit)

        assert doubts(below) == ()
        assert "chi2 per sample" in doubts(above)[0]
        assert "correlation of neighbouring residuals is 0.19" in doubts(coloured)[0]
        # A unit in which nothing is wrong leaves as much.
        assert doubts(coloured, start=replace(start, healthy=healthy)) == ()
        assert doubts(above, start=replace(start, floor=1.2)) == ()
    # A push alone, and causes that do not bend, may leave some model error.
    for names in (["event"], ["coulomb", "viscous"], []):
        assert doubts_of_bending(start, [known[n] for n in names], None, windows, coloured) == ()


def test_read_log_refuses_swapped_columns(tmp_path):
    log = hidden_log("rod_pendulum", {}, "steps", 172, 10.0)
    torque, theta, omega = (log.channels[n] for n in ("torque", "theta", "omega"))
    held = torque.hold(theta.t)
    rows = np.column_stack([theta.t, held, omega.value, theta.value])  # theta and omega swapped
    path = tmp_path / "swapped.csv"
    np.savetxt(path, rows, delimiter=",", header="t,torque,theta,omega", comments="")
    path.with_suffix(".yaml").write_text(
        "system: rod_pendulum\ntime: {column: t, unit: s}\nchannels:\n"
        "  torque: {column: torque, unit: N m, kind: command}\n"
        "  theta: {column: theta, unit: rad, kind: measurement}\n"
        "  omega: {column: omega, unit: rad/s, kind: measurement}\n"
    )
    channels = [(c.name, c.unit, c.kind) for c in (*BASE.commands, *BASE.measurements)]
    with pytest.raises(LogError, match="columns are swapped"):
        read_log(path, system="rod_pendulum", channels=channels)


@pytest.mark.parametrize(
    ("values", "driven"),
    [
        ({}, False),
        ({"coulomb.torque": 0.05}, False),
        ({"coulomb.torque": -0.05}, True),
        ({"coulomb.torque": -0.05, "viscous.change": 0.05}, True),  # it drives at low speeds
        ({"stribeck.coulomb": -0.02, "stribeck.breakaway": 0.3, "stribeck.speed": 2.0}, True),  # at high ones
        ({"viscous.change": 0.1, "quadratic.drag": -0.001}, False),
    ],
)
def test_doubts_of_friction_are_raised_where_friction_drives_the_joint(windows, values, driven):
    start = baseline_from(BASE, windows)
    problem, known = FitProblem(start.system, windows), catalogue(BASE)
    fit = problem.evaluate({**start.values, **values})
    sd = {name: 0.1 * abs(value) for name, value in values.items()}
    fit = replace(fit, free=tuple(values), covariance=np.diag(np.square(list(sd.values()))))
    causes = [known[name] for name in dict.fromkeys(n.split(".")[0] for n in values)]
    moving = SimpleNamespace(omega=np.linspace(-5.0, 5.0, 200))
    found = doubts_of_friction(start.system, causes, fit, [moving], 1.0)
    assert len(found) == driven
    assert all("joint 1 would drive the joint" in text for text in found)
    # Hardly known, it may as well be none.
    vague = replace(fit, covariance=fit.covariance * 1e4)
    assert doubts_of_friction(start.system, causes, vague, [moving], 1.0) == ()
