"""Logs of simulated units, shared by the tests of identify."""

from functools import lru_cache

from deepkoco.graph.recording import Recording
from deepkoco.unit.record import record
from deepkoco.unit.unit_file import make_unit

MASS, VISCOUS, DELAY = 0.056, 2.0e-5, 0.012


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
