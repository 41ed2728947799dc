"""Fits of a system with two joints, to motion integrated by SciPy."""

from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from deepkoco.graph.recording import Recording, Series
from deepkoco.identify import FitError, fit
from deepkoco.systems import make_system

TRUE = {"mass_2": 2.6, "viscous_1": 1.8, "viscous_2": 0.6}
LATE = {1: 0.012, 2: 0.03}  # [s], by joint
ZEROS = (0.04, -0.03)  # of the second encoder, by log [rad]
PERIOD = 0.05  # of the commands [s]


@lru_cache
def arm_log(seed: int, zero: float = 0.0, late: bool = False, seconds: float = 8.0) -> Recording:
    """The arm under random torques; each command may act late, each joint by a time of its own."""
    rng = np.random.default_rng(seed)
    arm = make_system("two_link_arm")
    parameters = arm.default_parameters() | {n: torch.tensor(v, dtype=torch.float64) for n, v in TRUE.items()}
    sent = PERIOD * np.arange(round(seconds / PERIOD))
    torque = rng.uniform(-1.0, 1.0, (len(sent), 2)) * [6.0, 3.0]
    delay = np.array([LATE[1], LATE[2]]) if late else np.zeros(2)

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        # A hair later, so that the command of an instant acts from it on.
        held = [torque[max(int((t - delay[j] + 1e-9) / PERIOD), 0), j] * (t >= delay[j]) for j in (0, 1)]
        return arm.derivative(
            torch.from_numpy(x), torch.tensor(held, dtype=torch.float64), parameters
        ).numpy()

    jumps = np.unique(np.round(np.concatenate([sent + d for d in delay]), 9))
    state, edges = np.array([0.3, 0.5, 0.0, 0.0]), np.append(jumps[jumps < seconds], seconds)
    t = np.arange(0.0, seconds - 0.005, 0.01)
    states = np.zeros((len(t), 4))
    for begin, end in pairwise(edges):
        inside = (t >= begin - 1e-9) & (t < end - 1e-9)
        run = solve_ivp(
            lambda u, x, middle=0.5 * (begin + end): slope(middle, x),
            (begin, end), state, t_eval=np.append(np.clip(t[inside], begin, end), end), rtol=1e-7, atol=1e-9,
        )  # fmt: skip
        states[inside], state = run.y.T[:-1], run.y[:, -1]
    noise = [c.noise_sd for c in arm.measurements] * rng.standard_normal(states.shape)
    values = states + noise + np.array([0.0, zero, 0.0, 0.0])
    channels = {
        c.name: Series(t, values[:, i], c.unit, "measurement") for i, c in enumerate(arm.measurements)
    }
    for i, c in enumerate(arm.commands):
        channels[c.name] = Series(sent, torque[:, i], c.unit, "command")
    return Recording(channels, system="two_link_arm")


def test_parameters_of_two_joints_are_recovered():
    found = fit([arm_log(0)], "two_link_arm", list(TRUE))
    for name, true in TRUE.items():
        estimate = found.estimates[name]
        assert estimate.value == pytest.approx(true, rel=0.02)
        assert abs(estimate.value - true) < 4.0 * estimate.sd
    assert found.convergence.converged
    assert found.dispersion.chi2_per_sample == pytest.approx(1.0, abs=0.1)


def test_each_joint_has_a_delay_of_its_own():
    delays = {f"actuation_delay(joint {j}).delay": late for j, late in LATE.items()}
    found = fit([arm_log(1, late=True)], "two_link_arm", ["mass_2", *delays], start=_known("mass_2"))
    assert found.estimates["mass_2"].value == pytest.approx(TRUE["mass_2"], rel=0.02)
    for name, late in delays.items():
        assert found.estimates[name].value == pytest.approx(late, abs=0.001)


def test_the_zero_of_the_second_encoder_is_found_log_by_log():
    logs = [arm_log(seed, zero) for seed, zero in zip((2, 3), ZEROS, strict=True)]
    found = fit(logs, "two_link_arm", ["mass_2"], start=_known("mass_2"), zero_sd=0.1)
    zeros = {z.name: z for z in found.zeros}
    assert found.estimates["mass_2"].value == pytest.approx(TRUE["mass_2"], rel=0.02)
    for log, true in enumerate(ZEROS, 1):
        zero = zeros[f"zero of angle_2 of log {log}"]
        assert zero.value == pytest.approx(true, abs=4.0 * zero.sd)
        assert zero.sd < 0.01
        # Turning the whole arm in a horizontal plane changes nothing: that zero stays what its prior says.
        assert zeros[f"zero of angle_1 of log {log}"].sd == pytest.approx(0.1, rel=0.01)


def test_an_effect_without_its_joint_is_completed():
    with pytest.raises(FitError, match=r"did you mean .*coulomb\(joint 1\).torque"):
        fit([arm_log(0)], "two_link_arm", ["coulomb.torque"])


def _known(*sought: str) -> dict[str, float]:
    return {name: value for name, value in TRUE.items() if name not in sought}
