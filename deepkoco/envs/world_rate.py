"""The tick of the simulated physics that a system needs."""

from __future__ import annotations

import math

import torch

from deepkoco.systems import Motion, System

STABLE = 1.4  # the classical Runge-Kutta method is stable up to 2.8 for a decaying, 2.6 for a swinging mode
SLOWEST, FASTEST = 100.0, 20_000.0  # [Hz]
SAMPLES = 8
STEP = 1e-6  # of the numerical derivatives
SPEEDS = {"rad": 1.0, "m": 0.3}  # dry friction at rest, smoothed or not, sets no tick


def slowest_world_rate(system: System, control_rate: float, speed_limit: float = math.inf) -> float:
    """Slowest tick at which the equations can be integrated, a multiple of the control rate.

    The largest eigenvalue of the linearised equations at a few moving states decides.

    Args:
        system: The system with its nominal parameters.
        control_rate: Rate of the agent [Hz].
        speed_limit: The joints go no faster.

    Returns:
        100 to 20,000 Hz.
    """
    joints = system.joints
    draws = torch.rand(2 * joints + len(system.commands), SAMPLES, generator=torch.Generator().manual_seed(0))
    draws = 2.0 * draws.double() - 1.0
    units = system.state_units[:joints]
    spans = [math.pi if u == "rad" else 0.5 for u in units] + [min(SPEEDS[u], speed_limit) for u in units]
    state = torch.stack([span * draws[k] for k, span in enumerate(spans)])  # (2 J, K)
    state[joints:] += torch.tensor(spans[joints:])[:, None].double() * state[joints:].sign()
    commands = [
        0.5 * (c.low + c.high) + 0.5 * (c.high - c.low) * u
        for c, u in zip(system.commands, draws[2 * joints :], strict=True)
    ]
    law = system.accelerations(system.default_parameters())

    def accelerations(at: torch.Tensor) -> torch.Tensor:
        motion = Motion(
            at[:joints].unbind(0), at[joints:].unbind(0), tuple(commands), None, torch.zeros(()).double()
        )
        return torch.stack([a.expand(SAMPLES) for a in law(motion)])

    columns = []
    for k in range(2 * joints):
        shift = torch.zeros_like(state)
        shift[k] = STEP
        columns.append((accelerations(state + shift) - accelerations(state - shift)) / (2.0 * STEP))
    lower = torch.stack(columns, -1).permute(1, 0, 2)  # (K, J, 2 J)
    upper = torch.cat([torch.zeros(joints, joints), torch.eye(joints)], -1).double().expand(SAMPLES, -1, -1)
    fastest = float(torch.linalg.eigvals(torch.cat([upper, lower], 1).nan_to_num()).abs().max())
    wanted = min(max(SLOWEST, fastest / STABLE), FASTEST)
    return control_rate * math.ceil(wanted / control_rate - 1e-9)
