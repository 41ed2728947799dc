"""What each fit knows of a unit, and its open-loop error on a log that it has not seen."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from deepkoco.fit import Identification, cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.simulate.simulator import trajectories
from deepkoco.fit.threads import one_thread
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem
from deepkoco.vision import SeenPendulum, identify_seen
from experiments.studies.camera.units import CAMERA, DELAYS, PENDULUM, TACHOMETER, Taken

BIAS = "torque_bias.effort"
ALL = (*PENDULUM, BIAS, *DELAYS, *CAMERA, *TACHOMETER)
FREE = {
    "all": ALL,
    "no camera delay": tuple(n for n in ALL if n != "camera_delay"),
    "nominal camera": tuple(n for n in ALL if n not in CAMERA),
    "camera alone": tuple(n for n in ALL if n not in TACHOMETER),
}
"""What each fit seeks; the rest stays nominal, and a delay 0. "camera alone" has no tachometer in its log."""
TRUE = "true values"
OPEN_LOOP, SETTLING = 21.0, 1.0  # [s]
LENGTH = SETTLING + OPEN_LOOP + 0.5  # of a log [s]


def identify(log: Recording, kind: str) -> tuple[Identification, float]:
    """Fit the model to a log; also returns the processor time [s]."""
    if kind == "camera alone":
        log = replace(log, channels={n: s for n, s in log.channels.items() if n != "omega"})
    began = time.process_time()
    found = identify_seen([log], FREE[kind])
    return found, time.process_time() - began


@dataclass(frozen=True)
class OpenLoop:
    """Angles of one simulation of a whole log.

    Attributes:
        t: (n,) after the start of the log [s].
        angle, true: (n,) [rad].
    """

    t: np.ndarray
    angle: np.ndarray
    true: np.ndarray

    @property
    def rms(self) -> float:
        """Root mean square of the error [rad]."""
        return float(np.sqrt(np.mean((self.angle - self.true) ** 2)))


def open_loop(values: Mapping[str, float], taken: Taken, sensors: Recording | None = None) -> OpenLoop:
    """Simulate a log under its commands: the state is found in the first second, then 21 s follow without a look.

    Args:
        values: Parameters; those that are left out are nominal.
        taken: The recording.
        sensors: The log with the channels that the state is found from; None takes all.
    """
    log = taken.log if sensors is None else sensors
    base = SeenPendulum()
    extended = ExtendedSystem(base, ("actuation_delay", "torque_bias"))
    whole = {p.name: float(values.get(p.name, p.value)) for p in extended.parameters}
    with one_thread():
        first = cut_windows([log], extended, SETTLING, cover=True).take(np.array([0]))
        state, _ = FitProblem(extended, first).fit_states(
            whole | dict.fromkeys(Push.NAMES, 0.0), first.state, 40
        )
        windows = cut_windows([log], extended, SETTLING + OPEN_LOOP, cover=True).take(np.array([0]))
        tensors = {n: torch.tensor(v, dtype=torch.float64) for n, v in whole.items()}
        states, _, _ = trajectories(extended, windows, tensors, state[None])
    after = windows.step * np.arange(len(states))
    kept = (after >= SETTLING) & (after <= SETTLING + OPEN_LOOP)
    # The state of a log is the one that the camera shows: it was there the camera's delay ago.
    when = windows.t0[0] + after[kept] - whole["camera_delay"]
    angle, (t, true) = states[:, 0, 0, 0].numpy()[kept], taken.truth
    true = np.interp(when, t, true)
    # The reader cannot know in which turn a pendulum begins that hangs at +-180 degrees.
    angle = angle + 2.0 * np.pi * np.round((true[0] - angle[0]) / (2.0 * np.pi))
    return OpenLoop(when, angle, true)
