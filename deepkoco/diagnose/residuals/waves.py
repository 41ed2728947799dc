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
SLOTS = 100  # of a window at most, in each of which a load is even
UNIT = 1e-4  # load of a response, in typical loads of the joint
LEAST_STEPS = 20  # of a window, and samples
TINY = 1e-6  # change of an initial state of a response


class Waves(NamedTuple):
    """Residuals of a fit, to be explained by loads a sin(k q) + b cos(k q) on one joint.

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

    def answering(self) -> Answers:
        """Return the responses to loads in each slot of a window, of which those to any wave are sums."""
        windows, unit = (
            self.problem.with_usual_steps.windows,
            UNIT * self.problem.system.load_scales[self.joint],
        )
        # Steps of the windows may be parts of those that are simulated.
        parts = self.problem.windows.steps // windows.steps
        each = -(-windows.steps // SLOTS)
        slots = [slice(at, at + each) for at in range(0, windows.steps, each)]
        loads = []
        for slot in slots:
            load = torch.zeros(len(windows), windows.steps, dtype=torch.float64)
            load[:, slot] = unit
            loads.append(load.repeat_interleave(parts, 1))
        responses = torch.cat(
            [self._responses(loads[at : at + LANES], 0) for at in range(0, len(loads), LANES)]
        )
        states = self._responses([], self.fit.state.shape[1])
        basis, _ = torch.linalg.qr((states / TINY).permute(1, 2, 0))
        residual = self.fit.residual.reshape(len(windows), -1, 1)
        responses = (responses / unit).permute(1, 2, 0)
        responses = responses - basis @ (basis.mT @ responses)
        ends = [slice(parts * slot.start, parts * min(slot.stop, windows.steps)) for slot in slots]
        return Answers(self, ends, responses.mT @ responses, (responses.mT @ residual)[..., 0])

    def responses(self, sizes: np.ndarray, had: np.ndarray) -> Tensor:
        """Return the whitened changes (D, W, CN) by such loads in the place of another one.

        Args:
            sizes: (D, 3) pitch, a and b of each.
            had: (3,) those that the fit has.
        """
        middle = self.middle()

        def load(pitch: float, a: float, b: float) -> Tensor:
            phase = 2.0 * math.pi / pitch * middle
            return a * torch.sin(phase) + b * torch.cos(phase)

        base = load(*had.tolist())
        loads = [load(*size) - base for size in sizes.tolist()]
        return torch.cat([self._responses(loads[at : at + LANES], 0) for at in range(0, len(loads), LANES)])

    def middle(self) -> Tensor:
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


class Answers(NamedTuple):
    """Normal equations of a load in each slot of a window, without what initial states do.

    Attributes:
        waves: Of which they are.
        slots: Steps of each slot.
        gram: (W, K, K) products of the whitened responses to a load of 1 in each slot.
        match: (W, K) products of these and the residuals.
    """

    waves: Waves
    slots: list[slice]
    gram: Tensor
    match: Tensor

    def explained(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much loads of each wave number lower chi2 (D,), and their a and b (D, 2) [N m or N].

        Args:
            numbers: (D,) wave numbers k [1/rad or rad/m].
        """
        loads = self._loads(numbers)
        acting = (self.gram @ loads.flatten(2)).unflatten(-1, loads.shape[2:])
        gram = (loads[..., :, None] * acting[..., None, :]).sum((0, 1))
        match = (loads * self.match[..., None, None]).sum((0, 1))
        gram = gram + 1e-9 * gram.diagonal(dim1=-2, dim2=-1).mean(-1)[:, None, None] * torch.eye(2)
        size = torch.linalg.solve(gram, match)
        return (size * match).sum(-1).numpy(), size.numpy()

    def _loads(self, numbers: np.ndarray) -> Tensor:
        """Return the means of the sines and cosines of wave numbers (D,) in each slot (W, K, D, 2)."""
        middle = self.waves.middle().numpy()
        begins = [slot.start for slot in self.slots]
        lengths = np.array([slot.stop - slot.start for slot in self.slots])
        loads = np.empty((len(middle), len(begins), len(numbers), 2))
        for d, number in enumerate(numbers):
            phase = number * middle
            for k, wave in enumerate((np.sin(phase), np.cos(phase))):
                loads[:, :, d, k] = np.add.reduceat(wave, begins, axis=1) / lengths
        return torch.from_numpy(loads)
