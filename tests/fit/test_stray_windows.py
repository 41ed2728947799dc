"""Fits of windows of which one is not followed along a straight step."""

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from deepkoco.fit.fit_types import Trial
from deepkoco.fit.solve.lazy_batch import LazyBatch
from deepkoco.fit.solve.levenberg_marquardt import Batch
from deepkoco.fit.solve.prior import Prior

WINDOWS, SAMPLES, TRUE = 20, 3, 2.0
STRAYS = 1e3  # residual of the last window, where its initial state is off by the square of a step
TRIAL_PRIOR = Prior(("x",), np.zeros(1), np.eye(1) * 1e4)


class OneStray:
    """Windows that show x + s. In the last one, the best s is 2 x - x^2, as a joint that sticks bends it.

    Args:
        windows: Which of all windows.
    """

    names, low, high = ("x",), np.full(1, -10.0), np.full(1, 10.0)
    scale, most_lanes = np.ones(1), 256
    nuisances = SimpleNamespace(
        varies=(),
        spread=np.zeros(0),
        precision=torch.zeros(0, dtype=torch.float64),
        none=lambda: torch.zeros(0, dtype=torch.float64),
    )

    def __init__(self, windows: Sequence[int] = range(WINDOWS), simulated: list[int] | None = None):
        self.index, self.simulated = list(windows), [] if simulated is None else simulated
        size = len(self.index)
        value = torch.zeros(size, 1, SAMPLES, dtype=torch.float64)
        value[:, 0, 0] = torch.tensor([0.0 if i == WINDOWS - 1 else TRUE for i in self.index])
        self.weight = torch.ones_like(value)
        self.windows = SimpleNamespace(
            value=value, state=torch.zeros(size, 2, dtype=torch.float64), samples=value.numel()
        )

    @property
    def with_usual_steps(self):
        return self

    def weighed(self, difference):
        return self.weight * difference

    def whitened(self, residual):
        return residual

    def of_windows(self, index):
        return OneStray([self.index[i] for i in index.tolist()], self.simulated)

    def nuisance_slopes(self, slopes):
        return slopes[:0]

    def predict(self, theta, state, nuisance):
        self.simulated.append(len(theta) * len(self.index))
        x = torch.from_numpy(theta)
        stray = torch.tensor(self.index) == WINDOWS - 1
        first = torch.where(stray, STRAYS * (state[..., 0] - 2.0 * x + x**2), x.expand(len(x), len(stray)))
        own = torch.where(stray, 0.0, state[..., 0])
        return torch.stack([first, own, state[..., 1]], -1)[:, :, None, :]


@pytest.mark.parametrize("kind", [Batch, LazyBatch])
@pytest.mark.parametrize("start", [-1.0, -1.0 + 1e-9, 5.0])
def test_one_window_that_goes_astray_does_not_hold_the_parameters_where_they_are(kind, start):
    problem = OneStray()
    state = problem.windows.state.clone()
    state[-1, 0] = 2.0 * start - start**2
    found = kind(problem, [Trial("stray", ("x",), TRIAL_PRIOR, {"x": start}, state)]).run(8)[0]
    assert found.converged
    assert found.values["x"] == pytest.approx(TRUE, abs=0.03)  # 19 windows, to a cost of 0.02
    assert float(found.state[-1, 0]) == pytest.approx(2.0 * TRUE - TRUE**2, abs=0.1)
    # All that is simulated beside the usual lanes is the window that strays.
    usual = [count for count in problem.simulated if count % WINDOWS == 0]
    assert len(problem.simulated) - len(usual) > 0
    assert all(count < WINDOWS for count in problem.simulated if count not in usual)
