"""Simulated motion of joints that stick and slide, against MuJoCo's frictionloss."""

import numpy as np
import pytest
import torch

pytest.importorskip("mujoco")

from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.simulate.simulator import predict
from deepkoco.systems import ExtendedSystem
from tests.oracle.stick_slip import stick_slip_log, stick_slip_system

LEVELS = {"hinge": (0.6,), "slide": (1.5,), "arm": (1.0, 0.5)}
STILL = {"hinge": 1e-3, "slide": 1e-4, "arm": 1e-3}  # speed below which MuJoCo's joint sticks


@pytest.mark.parametrize("kind", list(LEVELS))
def test_joints_stick_and_slide_as_in_mujoco(kind):
    base, levels = stick_slip_system(kind), LEVELS[kind]
    log = stick_slip_log(kind, levels, 1, 10.0, noisy=False, reach=3.0 if kind == "hinge" else 2.0)
    names = [base.at_joint("coulomb", j) for j in range(base.joints)]
    values = {f"{name}.torque": level for name, level in zip(names, levels, strict=True)}
    system = ExtendedSystem(base, tuple(names), values)
    windows = cut_windows([log], system, 1.0)
    shown = [log.channels[c.name] for c in base.measurements]
    initial = np.stack([np.interp(windows.t0, s.t, s.value) for s in shown], -1)
    found = predict(system, windows, system.default_parameters(), torch.from_numpy(initial)[None])[0].numpy()
    at = windows.t0[:, None] + windows.t[:, 0].numpy()
    for j in range(base.joints):
        true, speed = (np.interp(at, s.t, s.value) for s in (shown[j], shown[base.joints + j]))
        sticks = np.abs(speed) < STILL[kind]
        assert 0.05 < sticks.mean() < 0.95
        error = found[:, j] - true
        limit = 0.3 * base.measurements[j].noise_sd
        assert np.sqrt((error[sticks] ** 2).mean()) < limit
        assert np.sqrt((error[~sticks] ** 2).mean()) < limit
