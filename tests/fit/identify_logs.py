"""Logs of simulated units, shared by the tests of identify."""

from functools import lru_cache
from itertools import pairwise

import numpy as np
import torch
from scipy.integrate import solve_ivp

from deepkoco.excitation.record import record
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system
from deepkoco.unit.unit_file import make_unit

MASS, VISCOUS, DELAY = 0.056, 2.0e-5, 0.012
TRUE = {"mass_2": 2.6, "viscous_1": 1.8, "viscous_2": 0.6}
LATE = {1: 0.012, 2: 0.03}  # [s], by joint
PERIOD = 0.05  # of the commands [s]


@lru_cache
def pendulum_log(seconds: float = 8.0, seed: int = 0) -> Recording:
    """A disk pendulum that is heavier and stickier than nominal, with late commands."""
    spec = make_unit(
        "pendulum",
        parameters={"mass": MASS, "viscous": VISCOUS},
        effects={"actuation_delay": {"delay": DELAY}},
        seed=seed,
    )
    return record(spec, "steps", seconds, clock="simulated", seed=seed)


@lru_cache
def rod_log(seconds: float = 8.0, seed: int = 0, **parameters: float) -> Recording:
    """A rod pendulum with given true parameters."""
    return record(
        make_unit("rod_pendulum", parameters=parameters, seed=seed),
        "steps",
        seconds,
        clock="simulated",
        seed=seed,
    )


@lru_cache
def arm_log(seed: int, zero: float = 0.0, late: bool = False, seconds: float = 8.0) -> Recording:
    """The arm under random torques; with ``late``, the commands of each joint have a delay."""
    rng = np.random.default_rng(seed)
    arm = make_system("two_link_arm")
    parameters = arm.default_parameters() | {n: torch.tensor(v, dtype=torch.float64) for n, v in TRUE.items()}
    sent = PERIOD * np.arange(round(seconds / PERIOD))
    torque = rng.uniform(-1.0, 1.0, (len(sent), 2)) * [6.0, 3.0]
    delay = np.array([LATE[1], LATE[2]]) if late else np.zeros(2)

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        # Slightly later, so that a command acts from its own time stamp on.
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
