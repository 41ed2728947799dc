"""Simulations of a system with named values, in the package's own integrator: what most entrants hand back."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import FitProblem
from deepkoco.systems import ExtendedSystem, System
from experiments.studies.diagnosis.hidden_cause.questions import Simulate


def simulation_of(system: ExtendedSystem, values: Mapping[str, float]) -> Simulate:
    """Return the simulation of an extended system.

    Args:
        system: The system.
        values: Parameters that differ from its own; others are ignored.
    """
    own = {p.name: p.value for p in system.parameters}
    own |= {n: float(v) for n, v in values.items() if n in own}

    def simulate(windows: Windows, starts: Tensor) -> Tensor:
        problem = FitProblem(system, windows)
        nulls = {"event.duration": 0.1}
        theta = np.array([[own.get(n, nulls.get(n, 0.0)) for n in problem.names]])
        lanes = len(starts)
        nuisance = problem.nuisances.none()[None].expand(lanes, -1)
        with torch.no_grad():
            return problem.predict(theta.repeat(lanes, 0), starts, nuisance)

    return simulate


def as_given(system: System) -> Simulate:
    """Return the simulation of the model as given."""
    extended = system if isinstance(system, ExtendedSystem) else ExtendedSystem(system, ())
    return simulation_of(extended, {})
