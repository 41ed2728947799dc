"""Setup of an experiment: the unit as simulated, its limits and its sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline, baseline_from
from deepkoco.diagnose.experiment_design.families import Frame
from deepkoco.diagnose.experiment_design.stabiliser import Hold, find_hold
from deepkoco.fit.data.noise import Noise
from deepkoco.fit.data.windows import CommandSeries, Windows, period, window_length
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.systems import JOINT_SYSTEMS, ExtendedSystem, JointSystem, Motion, System

COMMAND_RATE, SENSOR_RATE = 50.0, 100.0  # [Hz]
SHORTEST = 4.0  # least length of a sequence, in windows
LONGEST = 300.0  # [s]


class DesignError(ValueError):
    """The requested experiment cannot be designed; the message says why."""


@dataclass(frozen=True)
class Limits:
    """Limits of a sequence, in the order of the system's commands and joints.

    Attributes:
        command: (M, 2) lowest and highest command, in the commands' units.
        position: (J, 2) lowest and highest coordinate [rad or m]; infinite where there is no limit.
        speed: (J,) largest speed, per second.
    """

    command: np.ndarray
    position: np.ndarray
    speed: np.ndarray

    @staticmethod
    def of(system: System, given: Mapping[str, tuple[float, float]] | None = None) -> Limits:
        """Return the limits of a system, narrowed by those given by the name of a command, coordinate or speed.

        Raises:
            DesignError: A name is unknown, or a range is empty, outside the actuator's, or one of speed without 0.
        """
        command = np.array([[c.low, c.high] for c in system.commands])
        joints = system.joints
        position, speed = np.tile([-math.inf, math.inf], (joints, 1)), np.full(joints, math.inf)
        if system.name in JOINT_SYSTEMS:
            # Above this speed a pendulum rotates fully and gravity averages out; `deepkoco record` also brakes there.
            speed[:] = 3.0 * 2.0 * math.pi / period(system)
        commands = [c.name for c in system.commands]
        for name, (low, high) in (given or {}).items():
            if not low < high:
                raise DesignError(f"limits of {name}: {low:g} is not below {high:g}")
            if name in commands:
                k = commands.index(name)
                if low < command[k, 0] - 1e-9 or high > command[k, 1] + 1e-9:
                    raise DesignError(
                        f"limits of {name}: {low:g} to {high:g} exceed the range of the actuator, "
                        f"{command[k, 0]:g} to {command[k, 1]:g} {system.commands[k].unit}"
                    )
                command[k] = low, high
            elif name in system.state_names[:joints]:
                position[system.state_names.index(name)] = low, high
            elif name in system.state_names:
                if not low < 0.0 < high:
                    raise DesignError(
                        f"limits of {name}: {low:g} to {high:g} excludes 0, but every experiment begins and ends at "
                        f"rest; give a range that contains 0, such as {name}={-max(abs(low), abs(high)):g}:"
                        f"{max(abs(low), abs(high)):g}"
                    )
                speed[system.state_names.index(name) - joints] = min(-low, high)
            else:
                known = ", ".join((*commands, *system.state_names))
                raise DesignError(f'limits: {system.name} has no "{name}"; it has: {known}')
        return Limits(command, position, speed)


@dataclass(frozen=True)
class Stage:
    """Setup of an experiment, without its commands.

    Attributes:
        start: Baseline: system with every effect, present values, prior.
        frame: Length, rate and number of the commands.
        limits: Limits of commands, positions and speeds.
        sensor_rate: Samples of every channel per second [Hz].
        noise: Noise of each channel.
        window: Length of the windows of the later diagnosis [s].
        initial: (S,) state at the beginning.
        rest: (M,) commands that hold this state.
        hold: Feedback that holds the unit in place; None where it does not drift.
    """

    start: Baseline
    frame: Frame
    limits: Limits
    sensor_rate: float
    noise: tuple[Noise, ...]
    window: float
    initial: np.ndarray
    rest: np.ndarray
    hold: Hold | None

    @property
    def system(self) -> ExtendedSystem:
        """The system with every effect of the registry."""
        return self.start.system

    def commands(self, signals: np.ndarray) -> np.ndarray:
        """Commands (K, n, M) of signals (K, n, M) in [-1, 1], where 0 is rest; the last tick goes back to rest."""
        low, high = self.limits.command.T
        rest = np.clip(self.rest, low, high)
        values = rest + np.where(signals >= 0.0, signals * (high - rest), signals * (rest - low))
        # Commands are rounded to the digits of the file, so that the file contains exactly the simulated commands.
        digits = 4 - math.floor(math.log10(float((high - low).max())))
        values = np.clip(np.round(values, digits), low, high)
        values[:, -1] = np.round(rest, digits)
        return values


def feasible_seconds(system: System, seconds: float) -> float:
    """Return the allowed length of an experiment [s] that is nearest to the requested one."""
    return min(max(seconds, SHORTEST * window_length(system)), LONGEST)


def make_stage(
    system: System,
    seconds: float,
    limits: Mapping[str, tuple[float, float]] | None = None,
    command_rate: float = COMMAND_RATE,
    sensor_rate: float = SENSOR_RATE,
    noise: tuple[Noise, ...] | None = None,
    values: Mapping[str, float] | None = None,
) -> Stage:
    """Return the setup of an experiment on a system.

    Args:
        system: Plain, or loaded from model.yaml.
        seconds: Length of the experiment [s].
        limits: Narrower limits by name of a command, coordinate or speed.
        command_rate: Commands per second [Hz].
        sensor_rate: Samples per second [Hz].
        noise: Noise of each channel; None takes the declared noise of the system.
        values: Baseline parameters fitted to a log; None takes the system's.

    Raises:
        DesignError: The length, a rate or a limit is not allowed, or an acceleration at rest is not finite.
    """
    window = window_length(system)
    if not SHORTEST * window <= seconds <= LONGEST:
        raise DesignError(
            f"an experiment of {seconds:g} s: give between {SHORTEST * window:.3g} and {LONGEST:g} s; a diagnosis "
            f"cuts the log into windows of {window:.3g} s and needs several"
        )
    if not 1.0 < command_rate <= sensor_rate <= 1e4:
        raise DesignError(
            f"commands at {command_rate:g} Hz and samples at {sensor_rate:g} Hz: give a command rate above 1 Hz and "
            "at most as high as the sample rate"
        )
    start = baseline_from(system, nothing(system))
    if values is not None:
        start.values.update({n: values[n] for n in start.prior.names})
    base = start.system.base
    initial = np.zeros(2 * base.joints)
    if isinstance(base, JointSystem) and base.name in JOINT_SYSTEMS:
        initial[0] = base.upright + math.pi
    bounds = Limits.of(base, limits)
    rest = rest_command(system, initial)
    try:
        hold = find_hold(system, initial, rest, bounds.command, period(base))
    except DivergedError as error:
        raise DesignError(f"{system.name}: {error}") from error
    frame = Frame(round(seconds * command_rate), command_rate, len(base.commands), period(base))
    return Stage(
        start,
        frame,
        bounds,
        sensor_rate,
        noise or tuple(Noise(c.noise_sd, 0.0) for c in base.measurements),
        window,
        initial,
        rest,
        hold,
    )


def rest_command(system: System, initial: np.ndarray) -> np.ndarray:
    """Return the commands (M,) with the smallest accelerations of the nominal system at a state (S,).

    Raises:
        DesignError: An acceleration is not finite there.
    """
    parameters = system.default_parameters()
    law, joints, count = system.accelerations(parameters), system.joints, len(system.commands)
    state = torch.from_numpy(initial)
    efforts = torch.cat([torch.zeros(1, count, dtype=torch.float64), torch.eye(count, dtype=torch.float64)])
    width = len(efforts)
    motion = Motion(
        tuple(state[j].expand(width) for j in range(joints)),
        tuple(state[joints + j].expand(width) for j in range(joints)),
        tuple(efforts[:, k] for k in range(count)),
        time=torch.zeros(width, dtype=torch.float64),
    )
    found = torch.stack(torch.broadcast_tensors(*law(motion)), -1).numpy()
    if not np.isfinite(found).all():
        joint = int(np.argwhere(~np.isfinite(found))[0, 1])
        at = ", ".join(f"{n} = {v:g}" for n, v in zip(system.state_names, initial, strict=True))
        raise DesignError(
            f"{system.name}: the acceleration of {system.joint_names[joint]} is not finite at {at}, the state in which "
            "an experiment begins; make accelerations() finite there"
        )
    return np.linalg.lstsq((found[1:] - found[0]).T, -found[0], rcond=None)[0]


def nothing(system: System) -> Windows:
    """Return an empty set of windows, for functions that only read its channels."""
    channels, states = len(system.measurements), 2 * system.joints
    empty = torch.zeros(0, channels, 0, dtype=torch.float64)
    series = (CommandSeries(np.zeros(1), np.zeros(1)),)
    noise = tuple(Noise(c.noise_sd, 0.0) for c in system.measurements)
    return Windows(
        series,
        np.zeros(0, dtype=int),
        np.zeros(0),
        0.01,
        1,
        empty,
        empty,
        empty.bool(),
        noise,
        torch.zeros(0, states, dtype=torch.float64),
        np.zeros(0, dtype=bool),
        system.measured_states,
    )
