"""Logs of the package's own unit in simulated time: another implementation still, with true sticking."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from deepkoco.excitation.record import record
from deepkoco.logs.recording import Recording
from deepkoco.systems import one_joint
from deepkoco.unit import make_unit
from tests.oracle.doses import unexplained
from tests.oracle.unit import Hidden


def unit_log(
    system: str, hidden: Hidden, excitation: str, seed: int, seconds: float = 30.0, noisy: bool = True
) -> Recording:
    """Log of a unit with parameters drawn within the system's priors.

    Args:
        system: Name of the system.
        hidden: Effects and their parameters.
        excitation: Name of the excitation.
        seed: Seed of parameters, excitation and noise.
        seconds: Length of the log [s].
        noisy: Whether the sensors have noise.
    """
    base = one_joint(system)
    rng = np.random.default_rng(seed)
    parameters = {}
    for p in base.parameters:
        # Within two standard deviations: beyond that the data sheet would be wrong.
        shift = float(np.clip(rng.standard_normal(), -2.0, 2.0))
        parameters[p.name] = float(np.clip(p.value + p.prior_sd * shift, p.low, p.high))
    sensor: dict[str, Any] = {"rate_hz": 100.0}
    if not noisy:
        sensor["noise_sd"] = {c.name: 0.0 for c in base.measurements}
    spec = make_unit(system, effects=hidden, parameters=parameters, sensor=sensor, seed=seed)
    return record(spec, excitation, seconds, clock="simulated", seed=seed)


def strength(system: str, hidden: Hidden, excitation: str, seed: int, seconds: float = 30.0) -> float:
    """ES of what is hidden, on noise-free logs, against the same unit without the effect."""
    cost, samples = unexplained(unit_log(system, hidden, excitation, seed, seconds, noisy=False), system)
    healthy, other = unexplained(unit_log(system, {}, excitation, seed, seconds, noisy=False), system)
    return math.sqrt(max(cost / samples - healthy / other, 0.0))
