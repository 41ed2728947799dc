"""Actuator effects: what happens to a command before it becomes an effort."""

from __future__ import annotations

import math

import numpy as np
import torch
from numba import njit
from torch import Tensor

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.joint_state import JointState
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System

LONG = 30.0  # time over which a drift is judged [s]
FASTEST_RATE = 2000.0  # largest commands per second from which on a limit of the rate shows nowhere [1/s]


def _gain(system: System, command: int = 0) -> tuple[Parameter, ...]:
    return (Parameter("factor", 1.0, "1", -3.0, 10.0, 0.3, "k, effort per command"),)


def _apply_gain(command: Tensor, p: Parameters) -> Tensor:
    return p["factor"] * command


def _bias(system: System, command: int = 0) -> tuple[Parameter, ...]:
    limit, unit = system.commands[command].high, system.commands[command].unit
    return (Parameter("effort", 0.0, unit, -limit, limit, 0.2 * limit, "u0, effort at zero command"),)


def _apply_bias(command: Tensor, p: Parameters) -> Tensor:
    return command + p["effort"]


def _dead_zone(system: System, command: int = 0) -> tuple[Parameter, ...]:
    limit, unit = system.commands[command].high, system.commands[command].unit
    # Commands of one sign only lose a constant: that is a bias.
    declared = Parameter("width", 0.0, unit, 0.0, limit, 0.2 * limit, "w, half width")
    return (declared,) if system.commands[command].low < 0.0 else ()


def _apply_dead_zone(command: Tensor, p: Parameters) -> Tensor:
    return torch.sign(command) * torch.clamp(command.abs() - p["width"], min=0.0)


def _saturation(system: System, command: int = 0) -> tuple[Parameter, ...]:
    limit, unit = system.commands[command].high, system.commands[command].unit
    return (Parameter("limit", limit, unit, 0.02 * limit, limit, limit, "u_max, largest effort"),)


def _apply_saturation(command: Tensor, p: Parameters) -> Tensor:
    return torch.maximum(torch.minimum(command, p["limit"]), -p["limit"])


def _gain_curve(system: System, command: int = 0) -> tuple[Parameter, ...]:
    limit, unit = system.commands[command].high, system.commands[command].unit
    text = "c, change of the gain with the squared command"
    if not 0.0 < limit < math.inf:
        return ()  # there is no size at which a command would be large
    per = 1.0 / limit**2
    return (Parameter("curvature", 0.0, f"1/({unit})^2", -0.9 * per, 2.0 * per, 0.1 * per, text),)


def _apply_gain_curve(command: Tensor, p: Parameters) -> Tensor:
    # u (1 + c u^2): the torque of a motor whose iron saturates falls behind its current.
    return command + p["curvature"] * command**3


def _asymmetry(system: System, command: int = 0) -> tuple[Parameter, ...]:
    text = "a, share by which the gain differs from one direction to the other"
    declared = Parameter("share", 0.0, "1", -0.9, 0.9, 0.1, text)
    return (declared,) if system.commands[command].low < 0.0 else ()


def _apply_asymmetry(command: Tensor, p: Parameters) -> Tensor:
    # (1 + a) u for u > 0 and (1 - a) u for u < 0.
    return command + p["share"] * command.abs()


def _backlash(system: System, command: int = 0) -> tuple[Parameter, ...]:
    limit, unit = system.commands[command].high, system.commands[command].unit
    return (Parameter("width", 0.0, unit, 0.0, 0.5 * limit, 0.1 * limit, "w, half of the play"),)


def _apply_backlash(commands: Tensor, t: Tensor, p: Parameters) -> Tensor:
    """Play operator: the effort follows only when the command has crossed the play.

    y_k = min(max(y_{k-1}, u_k - w), u_k + w), from y = 0 before the log begins.
    Source: Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (1996).
    """
    play, given = torch.as_tensor(p["width"], dtype=torch.float64).numpy(), commands.numpy()
    shape = np.broadcast_shapes(given.shape, play.shape)
    lanes = [np.ascontiguousarray(np.broadcast_to(x, shape).reshape(len(given), -1)) for x in (given, play)]
    return torch.from_numpy(_followed(lanes[0], lanes[1][0]).reshape(shape))


@njit(cache=True, error_model="numpy", nogil=True)
def _followed(given: np.ndarray, play: np.ndarray) -> np.ndarray:
    """Efforts (K, L) that follow commands (K, L) behind half plays (L,)."""
    result = np.empty_like(given)
    last = np.zeros(given.shape[1])
    for k in range(len(given)):
        for lane in range(given.shape[1]):
            low, high = given[k, lane] - play[lane], given[k, lane] + play[lane]
            # Comparisons that fail for a play that is not a number pass it on; min and max do not.
            pulled = last[lane] if last[lane] >= low else low
            last[lane] = pulled if pulled <= high else high
            result[k, lane] = last[lane]
    return result


def _gain_drift(system: System, command: int = 0) -> tuple[Parameter, ...]:
    text = "r, share of the gain that is added per second since the log began"
    return (Parameter("rate", 0.0, "1/s", -0.5 / LONG, 2.0 / LONG, 0.3 / LONG, text),)


def _apply_gain_drift(commands: Tensor, t: Tensor, p: Parameters) -> Tensor:
    return commands * (1.0 + p["rate"] * (t - t[0]).reshape(-1, *[1] * (commands.ndim - 1)))


def _rate_limit(system: System, command: int = 0) -> tuple[Parameter, ...]:
    size, unit = system.commands[command].high, system.commands[command].unit
    if not 0.0 < size < math.inf:
        return ()
    declared = FASTEST_RATE * size
    text = "r, largest change of the effort per second"
    return (Parameter("limit", declared, f"{unit}/s", 0.1 * size, declared, 10.0 * size, text),)


def _apply_rate_limit(commands: Tensor, t: Tensor, p: Parameters) -> Tensor:
    """Effort that goes towards its command at most at a rate, from the first command on.

    A command is held for a while, in which the effort moves evenly; the effort of this time is its mean. The time after
    the last command counts as long as the one before.
    """
    limit, given = torch.as_tensor(p["limit"], dtype=torch.float64).numpy(), commands.numpy()
    gap = np.diff(t.numpy(), append=2.0 * t[-1] - t[-2] if len(t) > 1 else t[-1])
    shape = np.broadcast_shapes(given.shape, np.shape(limit))
    lanes = [np.ascontiguousarray(np.broadcast_to(x, shape).reshape(len(gap), -1)) for x in (given, limit)]
    return torch.from_numpy(_ramps(lanes[0], lanes[1][0], gap).reshape(shape))


@njit(cache=True)
def _ramps(given: np.ndarray, limit: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Mean efforts (K, L) while commands (K, L) are held for gaps (K,) [s], at most as fast as limits (L,)."""
    result = np.empty_like(given)
    last = given[0].copy()
    for k in range(len(given)):
        for j in range(given.shape[1]):
            away, reach = given[k, j] - last[j], limit[j] * gap[k]
            far = abs(away)
            # Over the ramp the effort is short of the command by half of what is missing.
            if far > reach:
                mean, short = far - 0.5 * reach, far - reach
            else:
                mean, short = 0.5 * (far * far) / reach if reach > 0.0 else 0.0, 0.0
            result[k, j] = given[k, j] - np.sign(away) * mean
            last[j] = given[k, j] - np.sign(away) * short
    return result


def _unit_slip(system: System, command: int = 0) -> tuple[Parameter, ...]:
    text = "c, effort per command: a constant between units"
    return (Parameter("factor", 1.0, "1", -2000.0, 2000.0, 1.0, text),)


def _crosstalk(system: System, pair: int = 0) -> tuple[Parameter, ...]:
    source, joint = system.coupled_joints[pair]
    most, unit = system.delivered_scales[system.command_joints.index(source)]
    if unit in (system.state_units[source], system.state_units[system.joints + source]):
        return ()  # a goal of a position or a speed is no load, and the system does not say what its servo delivers
    load = system.load_units[joint]
    limit = system.load_scales[joint] / most
    if not 0.0 < limit < math.inf:
        return ()
    per = "1" if unit == load else f"{load}/({unit})"
    return (
        Parameter("share", 0.0, per, -limit, limit, 0.1 * limit, "c, load on this joint per effort of that"),
    )


def _crosstalk_load(joint: JointState, p: Parameters) -> Tensor:
    return p["share"] * joint.effort


GAIN = Effect(
    "gain",
    "actuator",
    "command",
    _gain,
    "the actuator scales its command",
    _apply_gain,
    "command",
    shared=True,
)
TORQUE_BIAS = Effect(
    "torque_bias",
    "actuator",
    "command",
    _bias,
    "a constant effort adds to the command",
    _apply_bias,
    "command",
)
DEAD_ZONE = Effect(
    "dead_zone",
    "actuator",
    "command",
    _dead_zone,
    "small commands have no effect",
    _apply_dead_zone,
    "command",
)
SATURATION = Effect(
    "saturation",
    "actuator",
    "command",
    _saturation,
    "large commands are cut off",
    _apply_saturation,
    "command",
)
GAIN_CURVE = Effect(
    "gain_curve",
    "actuator",
    "command",
    _gain_curve,
    "the gain bends with the size of the command",
    _apply_gain_curve,
    "command",
)
ASYMMETRY = Effect(
    "asymmetry",
    "actuator",
    "command",
    _asymmetry,
    "the gain differs between the directions",
    _apply_asymmetry,
    "command",
)
BACKLASH = Effect(
    "backlash",
    "actuator",
    "series",
    _backlash,
    "there is play between command and effort",
    _apply_backlash,
    "command",
)
RATE_LIMIT = Effect(
    "rate_limit",
    "actuator",
    "series",
    _rate_limit,
    "the effort changes at a limited rate",
    _apply_rate_limit,
    "command",
)
GAIN_DRIFT = Effect(
    "gain_drift",
    "actuator",
    "series",
    _gain_drift,
    "the gain drifts in time",
    _apply_gain_drift,
    "command",
    shared=True,
)
UNIT_SLIP = Effect(
    "unit_slip",
    "unit",
    "command",
    _unit_slip,
    "the command is logged in another unit",
    _apply_gain,
    "command",
)
CROSSTALK = Effect(
    "crosstalk",
    "actuator",
    "load",
    _crosstalk,
    "a share of one actuator's effort acts on another joint",
    _crosstalk_load,
    "pair",
)
