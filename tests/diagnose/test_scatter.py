"""Tests of the noise on residuals that are drawn by hand."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepkoco.diagnose.baseline import Healthy, baseline_from
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.residuals.scatter import Scatter, jitter, noise_level, quantisation
from deepkoco.diagnose.verdict.noise_causes import scatter_findings
from deepkoco.fit import Fit, Noise, cut_windows
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.effects import effects_of
from tests.oracle.unit import hidden_log


def view(tau: float = 0.0, noise: tuple[float, float] = (0.002, 0.05), step: float = 0.0) -> Scatter:
    """Residuals of a perfect model whose channels have this noise, jitter tau [s] and grid of the angle [rad]."""
    base = make_system("rod_pendulum")
    log = hidden_log("rod_pendulum", {}, "steps", 140, 12.0, noisy=False)
    windows = cut_windows([log], base, 1.6, tuple(Noise(sd, 0.02) for sd in noise))
    rng = np.random.default_rng(5)
    value = windows.value.numpy().copy()
    rate = np.gradient(value, 0.01, axis=-1)
    scatter = np.array(noise)[None, :, None] * rng.standard_normal(value.shape)
    scatter += tau * rate * rng.standard_normal((len(windows), 1, value.shape[-1]))
    shown = value + scatter
    if step:
        shown[:, 0] = step * np.round(shown[:, 0] / step)
    residual = (shown - value) / np.array(noise)[None, :, None] * windows.valid.numpy()
    empty, nothing = np.zeros((0, 0)), torch.zeros(len(windows), 2)
    fit = Fit("perfect", (), {}, empty, empty, nothing, torch.zeros(1), 0.0, 0.0, torch.from_numpy(residual))
    return Scatter(base, replace(windows, value=torch.from_numpy(shown)), fit)


@pytest.mark.parametrize("tau", [0.001, 0.003])
def test_jitter_recovers_its_standard_deviation(tau):
    verdict = jitter(view(tau), 0)
    assert verdict.likelihood_ratio > 60.0
    assert verdict.low <= tau <= verdict.high
    assert verdict.value == pytest.approx(tau, rel=0.15)


def test_jitter_is_none_for_constant_noise():
    verdict = jitter(view(), 0)
    assert verdict is None or verdict.likelihood_ratio < 12.0


def test_noise_level_compares_noise_with_the_data_sheet():
    assert noise_level(view(), 0).likelihood_ratio < 1.0 if noise_level(view(), 0) else True
    loud = noise_level(view(noise=(0.008, 0.05)), 0)
    assert loud.value == pytest.approx(4.0)
    assert loud.likelihood_ratio > 60.0


def test_noise_level_leaves_out_what_the_rounding_of_commands_does():
    loud = view(noise=(0.002, 0.05))
    added = tuple(n.with_simulated(63.0 * n.sd**2) for n in loud.windows.noise)  # the whole: 8 times as much
    assert added[0].sd == pytest.approx(8.0 * 0.002)
    again = noise_level(loud._replace(windows=replace(loud.windows, noise=added)), 0)
    assert again is None or again.likelihood_ratio < 1.0


def test_noise_level_leaves_out_what_counts_as_noise_for_its_model_error():
    loud = view(noise=(0.008, 0.05))
    assert noise_level(loud._replace(floor=4.0), 0).value == pytest.approx(2.0)
    assert noise_level(loud._replace(floor=16.0), 0) is None


def test_quantisation_is_found_where_rounding_errors_exceed_the_noise_of_the_data_sheet():
    assert quantisation(view(step=0.02), 0).value == pytest.approx(0.02)
    # An encoder whose data sheet gives the standard deviation of its rounding errors.
    assert quantisation(view(step=0.002 * 12.0**0.5), 0) is None
    assert quantisation(view(step=0.001), 0) is None
    assert quantisation(view(), 0) is None


@pytest.mark.parametrize(("step", "named"), [(0.02, ()), (0.04, ("quantisation(theta)",))])
def test_noise_causes_are_named_only_beyond_what_healthy_logs_show(step, named):
    usual, shown = view(step=0.02), view(step=step)
    system = ExtendedSystem(usual.system, tuple(effects_of(usual.system)), {})
    healthy = Healthy((), usual.windows, baseline_from(usual.system, usual.windows), (), usual.fit)
    alone = scatter_findings(system, shown.windows, shown.fit, DETECTION)
    beside = scatter_findings(system, shown.windows, shown.fit, DETECTION, healthy)
    assert "quantisation(theta)" in [found.name for found in alone]
    assert tuple(found.name for found in beside) == named
