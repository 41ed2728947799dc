"""Gradients agree with complex steps through a simulation that shares no code with the package.

J theta'' = (u - theta' K) K/R + m g l sin(theta) - b theta' - c tanh(theta' / 0.1), one Runge-Kutta step a tick under
the mean of the commands that were held during it: command k acts from k / 50 Hz + delay to the next one.
"""

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from deepkoco.engines.assembly import make_graph
from deepkoco.graph import BatchedRuntime, draw_timing

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
STEPS, RATE, TICK = 25, 50, 0.01
NAMES = ("inertia", "mass", "length", "viscous", "motor_constant", "resistance", "coulomb")
VALUES = (1.599e-4, 0.0509, 0.0415, 1.43e-5, 0.0333, 7.73, 9.75e-4)
STEP = 1e-30


def simulate(
    values: NDArray[np.complex128],
    start: NDArray[np.complex128],
    commands: NDArray[np.complex128],
    delay: complex,
) -> complex:
    """Sum of squares of the last angle and speed; everything may be complex."""
    inertia, mass, length, viscous, constant, resistance, coulomb = values

    def derivative(x: NDArray[np.complex128], u: complex) -> NDArray[np.complex128]:
        torque = (u - x[1] * constant) * constant / resistance + mass * 9.81 * length * np.sin(x[0])
        return np.array([x[1], (torque - viscous * x[1] - coulomb * np.tanh(x[1] / 0.1)) / inertia])

    def clipped(t: complex, low: float, high: float) -> complex:
        return low if t.real < low else high if t.real > high else t

    x = start
    for k in range(1, round(STEPS / RATE / TICK) + 1):
        low, high = (k - 1) * TICK, k * TICK
        arrivals = [-1e9, *(i / RATE + delay for i in range(STEPS)), 1e9]
        held = [0.0, *commands]
        mean = (
            sum(
                u * (clipped(complex(b), low, high) - clipped(complex(a), low, high))
                for u, a, b in zip(held, arrivals[:-1], arrivals[1:], strict=True)
            )
            / TICK
        )
        k1 = derivative(x, mean)
        k2 = derivative(x + TICK / 2 * k1, mean)
        k3 = derivative(x + TICK / 2 * k2, mean)
        k4 = derivative(x + TICK * k3, mean)
        x = x + TICK / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return (x**2).sum()


def complex_steps(
    start: NDArray[np.float64], commands: NDArray[np.float64], delay: float
) -> NDArray[np.float64]:
    """Derivatives by all parameters, the start, all commands and the delay."""
    point = np.array([*VALUES, *start, *commands, delay], dtype=np.complex128)
    found = []
    for i in range(len(point)):
        moved = point.copy()
        moved[i] += 1j * STEP
        n = len(VALUES)
        found.append(simulate(moved[:n], moved[n : n + 2], moved[n + 2 : -1], complex(moved[-1])).imag / STEP)
    return np.array(found)


class Rollout:
    """The same in the package.

    Args:
        delay: of the commands [s].
    """

    def __init__(self, delay: float) -> None:
        graph = make_graph("pendulum", control_rate=RATE, actuation_delay=delay)
        assert float(graph.node("world").rate) * TICK == 1.0
        timing = draw_timing(graph, np.random.default_rng(0), STEPS, 1)
        self.runtime = BatchedRuntime(graph, timing, executor="fused")

    def loss(self, leaves: list[torch.Tensor]) -> torch.Tensor:
        *values, start, commands, delay = leaves
        parameters = dict(zip(NAMES, values, strict=True)) | {"agent.extra_delay": delay}
        state, _ = self.runtime.reset({"world": parameters}, torch.Generator(), {"world": {"state": start}})
        state, _ = self.runtime.rollout(state, commands, record=[])
        assert self.runtime.executor == "fused"
        return state.nodes["world"]["state"].square().sum()

    def leaves(self, start: NDArray[np.float64], commands: NDArray[np.float64]) -> list[torch.Tensor]:
        given = [torch.tensor(v, dtype=torch.float64) for v in VALUES]
        given += [torch.from_numpy(start)[None], torch.from_numpy(commands).reshape(-1, 1, 1)]
        return [value.requires_grad_() for value in (*given, torch.zeros((), dtype=torch.float64))]


ROLLOUTS = {delay: Rollout(delay) for delay in (0.0123, 0.004, 0.0377)}


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(delay=st.sampled_from(sorted(ROLLOUTS)), number=st.integers(0, 10**6))
def test_gradients_by_parameters_start_commands_and_delay(delay, number):
    random = np.random.default_rng(number)
    start, commands = random.normal(size=2) * 2, random.uniform(-3, 3, size=STEPS)
    leaves = ROLLOUTS[delay].leaves(start, commands)
    loss = ROLLOUTS[delay].loss(leaves)
    loss.backward()
    found = np.concatenate([np.ravel(leaf.grad) for leaf in leaves])
    expected = complex_steps(start, commands, delay)
    value = simulate(np.array(VALUES, complex), start.astype(complex), commands.astype(complex), delay).real
    # A pendulum near its upper rest makes rounding errors grow in time, in both simulations.
    np.testing.assert_allclose(loss.item(), value, rtol=1e-9)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("delay", [0.0123, 0.031])
def test_the_gradient_by_a_delay_is_the_slope_over_delays_that_are_drawn(delay):
    random, h = np.random.default_rng(1), 1e-6
    start, commands = random.normal(size=2), random.uniform(-3, 3, size=STEPS)
    rollout = Rollout(delay)
    leaves = rollout.leaves(start, commands)
    rollout.loss(leaves).backward()
    # With gradients also here: without, dry friction is a constraint, which sticks.
    high, low = (Rollout(delay + sign * h).loss(leaves).item() for sign in (1, -1))
    assert leaves[-1].grad.item() == pytest.approx((high - low) / (2 * h), rel=1e-4)
