"""Signs and zeros of joints from gravity: servos sag, and torques hold, in the direction that the model predicts."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
import torch

from deepkoco.systems import Motion, ParameterError, System

SLOW = 0.15  # speed below which gravity and friction dominate [rad/s or m/s]
INDEPENDENT = 1.0  # time after which two samples can count as independent [s]
POSE = 0.2  # size of the cells of positions; the samples of a cell count as one [rad or m]
FEWEST_POSES = 8
MOST_SAMPLES = 1200  # slow samples that are compared
MOST_SIGNS = 6  # joints whose signs are tried in all combinations
KNOWN = 5.0  # evidence from which a sign is known [nats]
SURE_ZERO = 15.0  # evidence from which another zero than the model's is proposed [nats]
NARROW = 0.3  # largest half width of a known zero [rad]
ZEROS = np.linspace(-1.5, 1.5, 25)  # zeros that are tried [rad]
_CREEP = 0.02  # speed over which the sign of dry friction is smoothed


class Slow(NamedTuple):
    """Samples at which all joints are slow.

    Attributes:
        q: (n, J) positions in the frame of the log, in SI.
        speed: (n, J) speeds.
        pull: (n, J) position minus goal of a servo, or minus the torque of a drive; NaN where not known.
        seconds: time that the samples cover [s].
    """

    q: np.ndarray
    speed: np.ndarray
    pull: np.ndarray
    seconds: float


class JointEvidence(NamedTuple):
    """What gravity says of one joint.

    Attributes:
        sign: 1 or -1, the direction of the joint against the model's.
        margin: evidence against the other direction [nats].
        explained: share of the pull that gravity explains.
        zero: value of the model's coordinate where the log says 0.
        width: half width of the zeros that fit as well; infinite if none was tried.
        gain: evidence for this zero against 0 [nats].
    """

    sign: int
    margin: float
    explained: float
    zero: float
    width: float
    gain: float

    @property
    def sign_known(self) -> bool:
        """Whether the direction is known."""
        return self.margin >= KNOWN

    @property
    def zero_known(self) -> bool:
        """Whether the zero is known."""
        return self.sign_known and self.width <= NARROW


def signs_and_zeros(system: System, slow: Slow, turning: list[bool]) -> list[JointEvidence] | None:
    """Compare the pull on the joints with gravity in the model, for all directions and for zeros of single joints.

    For each joint, the pull is regressed on the model's gravity, the speed, its smoothed sign and a constant. Gravity
    must act in the direction of the pull. The evidence is the fall of the log of the squared residuals, times half the
    number of distinct poses.

    Args:
        system: the model.
        slow: samples of the log.
        turning: whether each joint turns; zeros of joints that slide are not tried, for gravity does not show them.

    Returns:
        One entry for each joint; None if the model's gravity cannot be computed, or there are too few samples.
    """
    # A long rest in one pose says no more than a short one.
    poses = len(np.unique(np.round(slow.q / POSE), axis=0)) if len(slow.q) else 0
    count = min(slow.seconds / INDEPENDENT, float(poses))
    if len(slow.q) < 40 or count < FEWEST_POSES:
        return None
    stride = max(1, len(slow.q) // MOST_SAMPLES)
    slow = Slow(slow.q[::stride], slow.speed[::stride], slow.pull[::stride], slow.seconds)
    joints = slow.q.shape[1]
    try:
        gravity = _Gravity(system)
        at_rest = gravity(slow.q)
    except (ParameterError, NotImplementedError, RuntimeError, KeyError):
        return None
    scale = np.abs(at_rest).max(initial=0.0)
    heavy = [j for j in range(joints) if np.abs(at_rest[:, j]).max() > 1e-3 * scale] if scale > 0 else []
    tried = sorted(heavy, key=lambda j: -float(np.std(at_rest[:, j])))[:MOST_SIGNS]
    scores: dict[tuple[int, ...], np.ndarray] = {}
    for choice in product((1, -1), repeat=len(tried)):
        sign = np.ones(joints)
        sign[tried] = choice
        scores[tuple(sign.astype(int).tolist())] = _evidence(gravity, slow, sign, np.zeros(joints), count)
    best = max(scores, key=lambda sign: (float(scores[sign].sum()), sum(sign)))
    top, sign = float(scores[best].sum()), np.array(best, dtype=float)
    result = []
    for j in range(joints):
        others = [float(s.sum()) for signs, s in scores.items() if signs[j] != best[j]]
        margin = top - max(others) if others else 0.0
        zero, width, gain = 0.0, np.inf, 0.0
        if j in tried and turning[j] and margin >= KNOWN:
            zero, width, gain = _zero_of(gravity, slow, sign, j, count, top)
        explained = 1.0 - float(np.exp(-2.0 * scores[best][j] / count))
        result.append(JointEvidence(best[j], margin, explained, zero, width, gain))
    return result


class _Gravity:
    """Load of gravity and springs on each joint at rest, from the accelerations of the system."""

    def __init__(self, system: System) -> None:
        values = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in system.parameters}
        self.system, self.law = system, system.accelerations(values)

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """(n, J) loads [N m or N] at the positions (n, J), with servos at their goals and other drives off."""
        joints = self.system.joints
        angles = tuple(torch.from_numpy(np.ascontiguousarray(q[:, j])) for j in range(joints))
        none = torch.zeros(len(q), dtype=torch.float64)
        efforts = tuple(self._effort(k, angles, none) for k in range(len(self.system.commands)))

        def accelerate(loaded: int | None) -> torch.Tensor:
            loads = tuple(none + 1.0 if j == loaded else none for j in range(joints))
            motion = Motion(angles, (none,) * joints, efforts, loads)
            return torch.stack(torch.broadcast_tensors(*self.law(motion), none)[:-1], -1)

        free = accelerate(None)
        answer = torch.stack([accelerate(j) - free for j in range(joints)], -1)  # (n, J, J), inverse inertia
        return torch.linalg.solve(answer, free[..., None])[..., 0].numpy()

    def _effort(self, command: int, angles: tuple[torch.Tensor, ...], none: torch.Tensor) -> torch.Tensor:
        system = self.system
        channel = system.commands[command]
        if command < len(system.command_joints):
            joint = system.command_joints[command]
            if channel.unit == system.state_units[joint]:
                return angles[joint]
        return none + (channel.default or 0.0)


def _evidence(gravity: _Gravity, slow: Slow, sign: np.ndarray, zero: np.ndarray, count: float) -> np.ndarray:
    """(J,) evidence that gravity of the model acts on each joint [nats]."""
    load = gravity(slow.q * sign + zero)
    return np.array(
        [
            _of_joint(load[:, j], slow.speed[:, j] * sign[j], slow.pull[:, j] * sign[j], count)
            for j in range(len(sign))
        ]
    )


def _of_joint(load: np.ndarray, speed: np.ndarray, pull: np.ndarray, count: float) -> float:
    good = np.isfinite(pull)
    if good.sum() < 20 or np.std(load[good]) == 0.0 or np.std(pull[good]) == 0.0:
        return 0.0
    load, speed, pull = load[good], speed[good], pull[good]
    base = np.stack([speed, np.tanh(speed / _CREEP), np.ones(len(pull))], axis=1)
    without, _ = _residual(base, pull)
    with_load, slope = _residual(np.column_stack([load / np.std(load), base]), pull)
    # Quantised sensors leave at least this much.
    floor = 1e-12 * float(np.sum(pull**2)) + 1e-300
    return 0.5 * count * float(np.log((without + floor) / (with_load + floor))) if slope > 0 else 0.0


def _residual(matrix: np.ndarray, target: np.ndarray) -> tuple[float, float]:
    """Sum of squared residuals, and the first weight."""
    weights, *_ = np.linalg.lstsq(matrix, target, rcond=1e-10)
    return float(np.sum((target - matrix @ weights) ** 2)), float(weights[0])


def _zero_of(
    gravity: _Gravity, slow: Slow, sign: np.ndarray, joint: int, count: float, top: float
) -> tuple[float, float, float]:
    """Best zero of a joint, half width of the zeros that fit about as well, and its evidence against 0 [nats]."""
    totals = []
    for value in ZEROS:
        zero = np.zeros(len(sign))
        zero[joint] = value
        totals.append(float(_evidence(gravity, slow, sign, zero, count).sum()))
    best = int(np.argmax(totals))
    if totals[best] - top < SURE_ZERO:
        best = int(np.argmin(np.abs(ZEROS)))
    good = ZEROS[np.array(totals) > max(totals[best], top) - 2.0]  # about the 95 % interval
    inside = 0 < best < len(ZEROS) - 1
    width = max(float(ZEROS[best] - good.min()), float(good.max() - ZEROS[best])) if inside else np.inf
    return float(ZEROS[best]), max(width, float(ZEROS[1] - ZEROS[0])), totals[best] - top
