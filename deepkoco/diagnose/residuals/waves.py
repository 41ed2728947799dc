"""Loads that repeat along the way of a joint: how much of the residuals each pitch explains on the measured path."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.diagnose.residuals.loaded import under_loads
from deepkoco.fit.data.halves import halved
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.simulate.push import Push, push_torque
from deepkoco.fit.simulate.simulator import trajectories
from deepkoco.systems import ExtendedSystem

LANES = 160  # responses that are asked for at once
UNIT = 1e-4  # load of a response, in typical loads of the joint
LEAST_STEPS = 20  # of a window, and samples
TINY = 1e-6  # change of an initial state of a response


class Waves(NamedTuple):
    """Residuals of a fit, explained by loads a sin(k q) + b cos(k q) on one joint.

    A load of detents moves the simulation by whole pitches where it is missing, so a simulation with a little of it
    says nothing of its phase. The phase is therefore taken along the path q that the sensor shows, and the response
    to such a load is linear.

    Attributes:
        problem: Training windows.
        fit: The fit.
        system: The simulation at the fit.
        joint: The joint.
        path: (n + 1, W) its simulated positions at the nodes [rad or m].
    """

    problem: FitProblem
    fit: Fit
    system: ExtendedSystem
    joint: int
    path: np.ndarray

    def shown_path(self) -> np.ndarray:
        """Return the positions (W, n + 1) that the sensor shows, or the simulated ones where none shows the joint."""
        windows, path = self.problem.windows, self.path.T.copy()
        if self.joint not in windows.shows:
            return path
        c = list(windows.shows).index(self.joint)
        off = windows.errors(self.fit.residual.reshape(windows.value.shape))[:, c].numpy()
        nodes = windows.step * np.arange(windows.steps + 1)
        for w in range(len(windows)):
            valid = windows.valid[w, c].numpy()
            if valid.any():
                path[w] += np.interp(nodes, windows.t[w, c].numpy()[valid], off[w][valid])
        return path

    def halved(self) -> Waves | None:
        """Return the same in windows of half the length; None where they are too short, or the simulation diverges.

        Where a load that is missing has moved the simulation by a part of its pitch, its response is no longer linear.
        """
        problem = FitProblem(self.problem.system, halved(self.problem.windows))
        windows = problem.windows
        if windows.steps < LEAST_STEPS or int(windows.valid.sum(-1).max()) < LEAST_STEPS:
            return None
        fit = problem.evaluate(self.fit.values)
        if fit.diverged:
            return None
        states, _, _ = trajectories(self.system, windows, self._named(), fit.state[None])
        return self._replace(problem=problem, fit=fit, path=states[:, 0, :, self.joint].numpy())

    def _named(self) -> dict[str, Tensor]:
        values, names = self.fit.values, self.problem.names
        return {n: torch.tensor(values[n], dtype=torch.float64) for n in names if n not in Push.NAMES}

    def explained(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much loads of each wave number lower chi2 (K,), and their a and b (K, 2) [N m or N].

        Args:
            numbers: (K,) wave numbers k [1/rad or rad/m].
        """
        middle = self._middle()
        unit = UNIT * self.problem.system.load_scales[self.joint]
        states = self._responses([], self.fit.state.shape[1])
        basis, _ = torch.linalg.qr((states / TINY).permute(1, 2, 0))
        residual = self.fit.residual.reshape(len(middle), -1, 1)
        residual = residual - basis @ (basis.mT @ residual)
        falls, sizes = [], []
        each = LANES // 2
        for at in range(0, len(numbers), each):
            phases = [float(k) * middle for k in numbers[at : at + each]]
            loads = [unit * wave for phase in phases for wave in (torch.sin(phase), torch.cos(phase))]
            response = (self._responses(loads, 0) / unit).permute(1, 2, 0)
            response = response - basis @ (basis.mT @ response)
            pairs = response.reshape(*response.shape[:2], -1, 2)
            gram = torch.einsum("wmka,wmkb->kab", pairs, pairs)
            match = torch.einsum("wmka,wm->ka", pairs, residual[..., 0])
            gram = gram + 1e-9 * gram.diagonal(dim1=-2, dim2=-1).mean(-1)[:, None, None] * torch.eye(2)
            size = torch.linalg.solve(gram, match)
            falls.append((size * match).sum(-1).numpy())
            sizes.append(size.numpy())
        return np.concatenate(falls), np.concatenate(sizes)

    def responses(self, sizes: np.ndarray, had: np.ndarray) -> Tensor:
        """Return the whitened changes (D, W, CN) by such loads in the place of another one.

        Args:
            sizes: (D, 3) pitch, a and b of each.
            had: (3,) those that the fit has.
        """
        middle = self._middle()

        def load(pitch: float, a: float, b: float) -> Tensor:
            phase = 2.0 * math.pi / pitch * middle
            return a * torch.sin(phase) + b * torch.cos(phase)

        base = load(*had.tolist())
        loads = [load(*size) - base for size in sizes.tolist()]
        return torch.cat([self._responses(loads[at : at + LANES], 0) for at in range(0, len(loads), LANES)])

    def _middle(self) -> Tensor:
        """Return the positions (W, n) in the middle of each step."""
        path = torch.from_numpy(self.shown_path())
        return 0.5 * (path[:, 1:] + path[:, :-1])

    def _responses(self, loads: list[Tensor], states: int) -> Tensor:
        """Return the whitened changes (D, W, CN) by loads (W, n) on the joint, then by each initial state."""
        problem = self.problem.with_usual_steps
        windows = problem.windows
        joints, lanes = problem.system.joints, 1 + len(loads) + states
        push = torch.zeros(joints, lanes, len(windows), windows.steps, dtype=torch.float64)
        for lane, load in enumerate(loads):
            push[self.joint, 1 + lane] = load.unflatten(1, (windows.steps, -1)).mean(-1)
        initial = self.fit.state[None].repeat(lanes, 1, 1)
        for s in range(states):
            initial[1 + len(loads) + s, :, s] += TINY
        theta = np.array([self.fit.values[n] for n in problem.names])
        pushed = push_torque(windows, theta[None, -len(Push.NAMES) :], problem.system)
        push = push if pushed is None else push + pushed
        predicted = under_loads(problem, self.system, self._named(), initial, push)
        change = problem.weighed(predicted[1:] - predicted[0]).reshape(lanes - 1, len(windows), -1)
        return torch.where(torch.isfinite(change).all(-1, keepdim=True), change, 0.0)
