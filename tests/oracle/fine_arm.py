"""A servo arm whose motion is simulated in much finer steps than usual."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.windows import Windows, cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.fit_types import Fit, Trial
from deepkoco.fit.solve.fine_steps import with_steps_cut
from deepkoco.fit.solve.prior import Prior
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import ExtendedSystem, any_system
from tests.oracle.mujoco_drives import make_drive
from tests.oracle.mujoco_robots import random_arm

EXACT = 64  # parts of a step of the unit
RATE, SECONDS = 100.0, 6.0


def fine_arm(folder: Path) -> tuple[ExtendedSystem, Windows]:
    """A servo arm as a file in a folder, and windows of its motion, simulated in fine steps without noise."""
    robot = random_arm(np.random.default_rng(3), 3, "position")
    path = folder / "arm.xml"
    path.write_text(robot.xml)
    system = ExtendedSystem(any_system(str(path)), ())
    drive = make_drive(robot, np.random.default_rng(4), SECONDS, RATE)
    t = np.arange(round(SECONDS * RATE)) / RATE
    goals = np.array([drive(i, np.zeros(3)) for i in range(len(t))])
    series = {c.name: Series(t, goals[:, k], c.unit, "command") for k, c in enumerate(system.commands)}
    shown = {
        c.name: Series(t, goals[:, k], c.unit, "measurement") for k, c in enumerate(system.measurements[:3])
    }
    windows = cut_windows([Recording(series | shown)], system, 1.0)
    return system, windows.with_value(simulated(system, windows, EXACT))


def fit_of(system: ExtendedSystem, windows: Windows) -> Fit:
    """The values of the file, with the initial states of the windows."""
    problem = FitProblem(system, windows)
    values = dict.fromkeys(problem.names, 0.0) | {p.name: p.value for p in system.parameters}
    return problem.fit_one(Trial("own", (), Prior.empty(), values, windows.state), 1)


def simulated(system: ExtendedSystem, windows: Windows, parts: int) -> Tensor:
    """Simulated measurements (W, N, M) in steps that are cut into so many parts; 0 where padded."""
    cut = with_steps_cut(windows, parts)
    fit = fit_of(system, cut)
    return torch.where(cut.valid, cut.value - fit.residual * cut.sample_sd, 0.0)


def seen(windows: Windows, noise_sd: float) -> Windows:
    """The windows as sensors with so much noise show them."""
    noise = torch.randn(windows.value.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    windows = replace(windows, noise=tuple(n._replace(sd=noise_sd) for n in windows.noise))
    return windows.with_value(windows.value + noise_sd * noise)
