"""Refit with the usual set of parameters, as other tools identify an arm: what a diagnosis is compared with.

The set is armature, viscous and dry friction and a zero error of the sensor for each joint, and one delay of all
commands. Everything else keeps its value as given. The priors are as wide as the bounds allow, so they decide nothing.

Source of the set: PACE (Bjelonic et al., Towards bridging the gap: systematic sim-to-real transfer for diverse legged
robots, 2025), whose parameters of each joint are these, with one delay.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import FEW_WINDOWS, catalogue_system, few_windows
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.residual_noise import with_sharp_noise
from deepkoco.fit.solve.scale_search import search_scales
from deepkoco.systems import ExtendedSystem, System

OF_JOINT = ("armature", "damping", "frictionloss")
DELAY = "actuation_delay(all).delay"
DELAYS = (0.0, 0.05, 0.1)  # at which fits start [s]
WIDE = 100.0  # prior standard deviations of the usual set, in declared ones
SCOUTING, ITERATIONS = 8, 40


def usual_names(system: ExtendedSystem) -> list[str]:
    """Return the parameters of the set that a system has."""
    wanted = {f"{kind}({j})" for kind in OF_JOINT for j in system.joint_names}
    wanted |= {f"sensor_bias({j}).angle" for j in system.joint_names} | {DELAY}
    return [p.name for p in system.parameters if p.name in wanted]


def fit_usual_set(system: System, windows: Windows) -> tuple[dict[str, float], Fit]:
    """Fit the usual set to windows, from several delays; return all parameter values and the best fit.

    Sizes are searched for before slopes are used, as in the refit of a diagnosis.

    Args:
        system: The robot as given.
        windows: Windows to fit.
    """
    extended = catalogue_system(system)
    names = usual_names(extended)
    declared = [replace(p, prior_sd=WIDE * p.prior_sd) for p in extended.parameters if p.name in names]
    prior = Prior.of(declared)
    given = {p.name: p.value for p in extended.parameters}
    given |= {n: p.value for n, p in Push.declared(extended, windows).items()}
    some = windows.take(few_windows(windows, FEW_WINDOWS))
    sizes = [n for n in names if n.startswith(OF_JOINT)]
    problem = FitProblem(extended, windows)
    trials = []
    for delay in DELAYS:
        values, _ = search_scales(FitProblem(extended, some), sizes, {**given, DELAY: delay}, some.state)
        for start in (values, {**given, DELAY: delay}):
            state, _ = problem.fit_states(start, windows.state)
            trials.append(Trial("usual set", tuple(names), prior, start, state))
    scouts = problem.fit(trials, SCOUTING)
    best = int(np.argmin([fit.cost for fit in scouts]))
    problem = FitProblem(extended, with_sharp_noise(windows, scouts[best]))
    found = scouts[best]
    last = problem.fit_one(
        replace(trials[best], values=found.values, state=found.state, nuisance=found.nuisance), ITERATIONS
    )
    return last.values, last
