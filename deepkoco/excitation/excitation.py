"""Excitations: commands that make a log informative, open loop or from the measurement."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.random import Generator

from deepkoco.systems import JointSystem, System, one_joint

# (time since the start [s], last measurement in the order of the system's measurements) -> command
Excitation = Callable[[float, Sequence[float]], float]
LEVELS = 7  # of the steps


class ExcitationError(ValueError):
    """An excitation is unknown, or asks for more than the unit takes."""


def make_excitation(
    kind: str, system: str, seconds: float, seed: int = 0, amplitude: float | None = None
) -> Excitation:
    """Excitation for a system, its time scale taken from the system's natural period.

    Args:
        kind: One of :data:`EXCITATIONS`.
        system: Name of the system.
        seconds: Length of the log [s].
        seed: Seed of the excitation's own draws.
        amplitude: Largest command, in the command's unit; None takes the system's limit.

    Raises:
        ExcitationError: There is no such excitation, the amplitude is outside the limits, or the seed is
            negative.
    """
    if kind not in EXCITATIONS:
        raise ExcitationError(f'unknown excitation "{kind}"; known: {", ".join(EXCITATIONS)}')
    physics = one_joint(system)
    limit, unit = physics.command.high, physics.command.unit
    size = limit if amplitude is None else amplitude
    if not 0.0 < size <= limit:
        raise ExcitationError(f"amplitude {size:g} {unit} is outside (0, {limit:g}] {unit} of {system}")
    if seed < 0:
        raise ExcitationError(f"seed {seed} is negative; give 0 or more")
    generator = np.random.default_rng([seed, sorted(EXCITATIONS).index(kind)])
    excitation = EXCITATIONS[kind](physics, seconds, size, generator)
    return _speed_guard(excitation, size, natural_frequency(physics))


def natural_frequency(system: System) -> float:
    """Small oscillations of the nominal system about hanging [rad/s]."""
    assert isinstance(system, JointSystem)
    return math.sqrt(system.load_scale / float(system.inertia(system.default_parameters())))


def chirp(system: System, seconds: float, amplitude: float, generator: Generator) -> Excitation:
    """Sine whose frequency sweeps from a quarter to three times the natural one and back."""
    frequency = natural_frequency(system)
    low, high = 0.25 * frequency, 3.0 * frequency
    sweep = min(seconds, 24.0 * math.pi / frequency)  # up and down once [s]
    offset = generator.uniform(0.0, 2.0 * math.pi)

    def command(t: float, measurement: Sequence[float]) -> float:
        # Phase of a frequency that is a triangle in time: whole sweeps, then the part of this one.
        whole, part = divmod(t, sweep)
        up = min(part, 0.5 * sweep)
        down = part - up
        slope = 2.0 * (high - low) / sweep
        phase = whole * 0.5 * (low + high) * sweep + low * up + 0.5 * slope * up**2
        phase += high * down - 0.5 * slope * down**2
        return amplitude * math.sin(phase + offset)

    return command


def steps(system: System, seconds: float, amplitude: float, generator: Generator) -> Excitation:
    """Random levels, each held between a quarter of the natural period and one and a half."""
    period = 2.0 * math.pi / natural_frequency(system)
    levels = np.linspace(-amplitude, amplitude, LEVELS)

    def draw(last: float) -> float:
        others = levels[~np.isclose(levels, last)]
        return float(generator.choice(others))

    return _held(seconds, draw, lambda: generator.uniform(0.25, 1.5) * period)


def prbs(system: System, seconds: float, amplitude: float, generator: Generator) -> Excitation:
    """Pseudo-random binary sequence: either limit, drawn anew eight times per natural period."""
    period = 2.0 * math.pi / natural_frequency(system)
    return _held(
        seconds,
        lambda last: amplitude if generator.random() < 0.5 else -amplitude,
        lambda: period / 8.0,
    )


def bang_bang(system: System, seconds: float, amplitude: float, generator: Generator) -> Excitation:
    """Either limit, switched by the motion: pumps energy up to a random level, then takes it out.

    A torque that cannot lift the pendulum moves it through its whole range only in step with its
    swing. The energy is e = omega^2 / (2 omega_n^2) + 1 - cos(angle from hanging), so that the tip reaches
    the top at e = 2; levels are drawn between 0.3 and 3, a high one is given up after two natural
    periods and a low one after one.
    """
    assert isinstance(system, JointSystem)
    frequency = natural_frequency(system)
    period = 2.0 * math.pi / frequency
    hanging = system.upright + math.pi
    goal, pump, since = float(generator.uniform(1.0, 3.0)), True, 0.0
    last, moved = amplitude, 0.0

    def command(t: float, measurement: Sequence[float]) -> float:
        nonlocal goal, pump, since, last, moved
        theta, omega = measurement
        energy = 0.5 * (omega / frequency) ** 2 + 1.0 - math.cos(theta - hanging)
        if (energy >= goal) == pump or t - since > (2.0 if pump else 1.0) * period:
            pump, since = not pump, t
            goal = float(generator.uniform(1.0, 3.0) if pump else generator.uniform(0.3, 1.0))
        # Near standstill the sign of a noisy speed says nothing: keep the last command, unless it holds
        # the pendulum in balance.
        if abs(omega) > 0.1 * frequency:
            last, moved = math.copysign(amplitude, omega if pump else -omega), t
        elif t - moved > 0.2 * period:
            last, moved = -last, t
        return last

    return command


def policy_excitation(policy: Callable[[Sequence[float]], float], limits: tuple[float, float]) -> Excitation:
    """Closed loop under a policy.

    Args:
        policy: Measurement -> command.
        limits: Commands are cut to (low, high), in the command's unit.
    """

    def command(t: float, measurement: Sequence[float]) -> float:
        return min(max(float(policy(measurement)), limits[0]), limits[1])

    return command


def load_policy_excitation(folder: str | Path, system: str) -> tuple[Excitation, float]:
    """Closed loop under a trained policy, which sees what the system's task shows it.

    Args:
        folder: Folder of the trained policy.
        system: Name of the system.

    Returns:
        The excitation and the rate it was trained at [Hz].

    Raises:
        ExcitationError: The folder holds no policy, or one for other observations or commands.
    """
    # Imported here: agent and envs are heavy, and every other excitation does without them.
    import torch

    from deepkoco.agent.policy import KoopmanPolicy, load_model
    from deepkoco.envs.tasks import SWING_UPS

    physics, task = one_joint(system), SWING_UPS[system]
    try:
        model, planner, low, high = load_model(folder)
    except (OSError, ValueError) as error:
        raise ExcitationError(f"{folder}: holds no policy: {error}") from error
    width = len(task.observation_bounds)
    if model.observation_size != width:
        raise ExcitationError(
            f"{folder}: the policy takes {model.observation_size} observations, {system} gives "
            f"{width}; give a policy that was trained without distractors and without past actions"
        )

    limit = min(task.command_limit, physics.command.high)
    if not (np.array_equal(low, [-limit]) and np.array_equal(high, [limit])):
        raise ExcitationError(
            f"{folder}: the policy's actions lie in {low.tolist()} to {high.tolist()}, the commands of {system} "
            f"in [{-limit:g}] to [{limit:g}] {physics.command.unit}; give a policy that was trained on {system} "
            'with action_units="physical"'
        )
    policy = KoopmanPolicy(model, planner, low, high)

    def act(measurement: Sequence[float]) -> float:
        seen = task.observation(physics, torch.tensor(measurement, dtype=torch.float64))
        return float(policy.act(seen.numpy())[0])

    return policy_excitation(act, (-limit, limit)), 1.0 / model.time_step


def _speed_guard(excitation: Excitation, amplitude: float, frequency: float) -> Excitation:
    """Brake at full amplitude from 3 natural frequencies down to 2, the speed of a fall from the top.

    Without it a resonant or strong command ends in fast whirling, where gravity averages out.
    """
    braking = False

    def command(t: float, measurement: Sequence[float]) -> float:
        nonlocal braking
        speed = measurement[1]
        braking = abs(speed) > (2.0 if braking else 3.0) * frequency
        return math.copysign(amplitude, -speed) if braking else excitation(t, measurement)

    return command


def _held(seconds: float, draw: Callable[[float], float], hold: Callable[[], float]) -> Excitation:
    """Piecewise constant signal: ``draw`` gives the next level from the last, ``hold`` its length [s]."""
    ends, values, level = [0.0], [0.0], 0.0
    while ends[-1] <= seconds:
        level = draw(level)
        values.append(level)
        ends.append(ends[-1] + hold())
    switches, held = np.array(ends[:-1]), values[1:]

    def command(t: float, measurement: Sequence[float]) -> float:
        return held[max(int(np.searchsorted(switches, t, side="right")) - 1, 0)]

    return command


EXCITATIONS: dict[str, Callable[[System, float, float, Generator], Excitation]] = {
    "chirp": chirp,
    "steps": steps,
    "prbs": prbs,
    "bang-bang": bang_bang,
}
