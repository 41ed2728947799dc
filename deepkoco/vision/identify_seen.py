"""Fit of a seen pendulum, from both poses of the plane that look alike."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from deepkoco.fit import FitError, Identification, Prior, fit
from deepkoco.logs.read_logs import Logs
from deepkoco.vision.projection import CAMERA, SIDE
from deepkoco.vision.seen_pendulum import SENSING, SeenPendulum

TILTS = ("tilt_u", "tilt_v")


def known_of_sensors(parameters: Sequence[str]) -> Prior | None:
    """Prior over those of the parameters that belong to the camera and the tachometer: their declared spreads.

    The delay has none: nobody measures it at the bench. None if the parameters hold none of them.
    """
    own = [p for p in (*CAMERA, *SENSING) if p.name in parameters and p.name != "camera_delay"]
    return Prior.of(own) if own else None


def identify_seen(
    recordings: Logs,
    parameters: Sequence[str],
    *,
    prior: Prior | None = None,
    start: Mapping[str, float] | None = None,
    side: int = SIDE,
) -> Identification:
    """Fit parameters of a `SeenPendulum` by `deepkoco.fit.fit`, twice where tilts are sought.

    A circle that leans towards a far camera looks as one that leans away by as much; only the perspective tells them
    apart. The cost therefore has two minima, with opposite tilts. One fit starts at the nominal pose, a second one at
    the mirrored pose that the first has found, and the one with the greater likelihood is returned. Of five units
    of the study, one ended in the wrong pose without this.

    Args:
        recordings: As `seen_log` makes them.
        parameters: What is sought.
        prior: None takes `known_of_sensors`.
        start: Start values of single parameters.
        side: Width and height of the pictures [px].

    Raises:
        FitError: As for `deepkoco.fit.fit`.
        LogError: A log lacks the command or every measurement.
    """
    prior = known_of_sensors(parameters) if prior is None else prior
    system = SeenPendulum(side)
    found = fit(recordings, system, parameters, prior=prior, start=start)
    tilts = [name for name in TILTS if name in parameters]
    if not tilts:
        return found
    # What hangs together with the wrong pose (lens, scale, perspective) starts from its own start value.
    mirrored = {**(start or {}), **{name: -found.estimates[name].value for name in tilts}}
    try:
        other = fit(recordings, system, parameters, prior=prior, start=mirrored)
    except FitError:
        return found  # the mirrored pose follows no motion at all
    return other if _misfit(other) < _misfit(found) else found


def _misfit(found: Identification) -> float:
    """-2 log likelihood with the noise of each channel at its best value, without a constant.

    The costs of two fits cannot be compared: each has found its own noise.
    """
    valid = found.request.windows.valid
    counts = {c.name: int(valid[:, k].sum()) for k, c in enumerate(found.system.measurements)}
    rms = {name: after for name, (_, after, _) in found.rms.items() if counts[name]}
    return float(np.sum([counts[name] * 2.0 * math.log(max(after, 1e-12)) for name, after in rms.items()]))
