"""The limit of noise: chi2 per sample varies more where residuals are correlated."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.signal import lfilter

from deepkoco.diagnose.residuals import white_limit

SAMPLES, SHARE = 1500, 0.9


def test_limit_is_so_many_deviations_of_chi2_of_correlated_noise():
    white = np.random.default_rng(20000).standard_normal((4000, SAMPLES + 200))
    noise = np.asarray(lfilter([np.sqrt(1.0 - SHARE**2)], [1.0, -SHARE], white, axis=1))[:, 200:]
    spread = np.square(noise).mean(1).std()
    windows: Any = SimpleNamespace(
        samples=SAMPLES,
        valid=torch.ones(1, 1, SAMPLES, dtype=torch.bool),
        noise=(SimpleNamespace(relative_sd=0.0),),
    )
    correlation = (1.0 + SHARE) / (1.0 - SHARE)
    assert white_limit(windows, correlation, 4.0) - 1.0 == pytest.approx(4.0 * spread, rel=0.05)
    assert white_limit(windows, deviations=4.0) - 1.0 == pytest.approx(4.0 * np.sqrt(2.0 / SAMPLES))
