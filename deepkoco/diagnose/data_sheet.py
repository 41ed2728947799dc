"""What a data sheet says of one unit: its own parameters, and how far units of one make differ from them.

A model file (MJCF, URDF) states no prior. The one by kind says how far a parameter may be off at all, in a rough model
or as a fault. Taken for what any unit has, it lets a refit move a damping by half or a mass by a tenth at no price: the
hidden cause goes into the parameters, and a small error of the model that is left takes its place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes.tolerance import usual_sd


def guessed(start: Baseline) -> bool:
    """Return whether nobody stated the priors of some parameters of a baseline."""
    return any(start.system.parameter(n).guessed for n in start.prior.names)


def with_usual_spread(start: Baseline) -> Baseline:
    """Return a baseline without healthy logs in which guessed priors are those of units of one make.

    No parameter has to be kept for a scale that the log leaves open: these priors settle it.

    Args:
        start: The baseline.
    """
    covariance, centre = start.prior.covariance.copy(), start.prior.centre.copy()
    for i, name in enumerate(start.prior.names):
        parameter = start.system.parameter(name)
        if parameter.guessed:
            covariance[i, :] = covariance[:, i] = 0.0
            covariance[i, i] = usual_sd(parameter) ** 2
            centre[i] = start.values[name]
    return replace(
        start, prior=replace(start.prior, centre=np.asarray(centre), covariance=covariance), gauges=()
    )
