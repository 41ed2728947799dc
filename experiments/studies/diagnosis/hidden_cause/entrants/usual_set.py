"""The usual set of parameters by CMA-ES: armature, viscous and dry friction, a bias, and a delay, for each joint.

Source of the set: PACE (Bjelonic et al., Towards bridging the gap: systematic sim-to-real transfer for diverse legged
robots, 2025), whose bias is that of the encoder. Where a model has no armature, viscous or dry friction, the effect of
the package takes its place. There is no prior: the search starts from the values as given and knows only bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cma
import numpy as np
import torch

from deepkoco.fit.data.windows import Windows, cut_windows, moving
from deepkoco.fit.fit import FitProblem
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem, System
from deepkoco.systems.effects import effects_of
from experiments.studies.diagnosis.hidden_cause.entrants.as_given import simulation_of
from experiments.studies.diagnosis.hidden_cause.entrants.naming import first_name, usual_scale
from experiments.studies.diagnosis.hidden_cause.questions import Answer, Handed

GENERATIONS = 60  # of each of two rounds
MOST_WINDOWS = 16
SPREAD = 2.0  # standard deviation of the first generation, in usual scales


class UsualSet:
    """CMA-ES over the usual set; names the largest change in its usual scale (`naming`)."""

    name = "usual_set"

    def answer(self, handed: Handed) -> Answer:
        """Fit the set to the log, and to the healthy logs to compare with."""
        system = with_usual_effects(handed.system)
        found = fit(system, handed.log, handed.window, handed.seed)
        before = {n: system.parameter(n).value for n in found}
        if handed.healthy:
            before = fit(system, handed.healthy, handed.window, handed.seed)
        prior_sd = {n: system.parameter(n).prior_sd for n in found}
        name = first_name(handed.system, before, found, prior_sd)
        return Answer(name, (name,), simulation_of(system, found))


def with_usual_effects(base: System) -> ExtendedSystem:
    """Extend a system by what it lacks of the usual set."""
    own, known = {p.name for p in base.parameters}, effects_of(base)
    wanted = []
    for j, joint in enumerate(base.joint_names):
        wanted += [] if f"damping({joint})" in own else [base.at_joint("viscous", j)]
        wanted += [] if f"frictionloss({joint})" in own else [base.at_joint("coulomb", j)]
        wanted += [base.at_joint("sensor_bias", j), base.at_joint("actuation_delay", j)]
    return ExtendedSystem(base, tuple(n for n in wanted if n in known))


def usual_names(system: ExtendedSystem) -> list[str]:
    """Return the parameters of the set: those of the model, and of the effects that it was extended by."""
    kinds = ("armature(", "damping(", "frictionloss(")
    return [p.name for p in system.parameters if p.name.startswith(kinds) or "." in p.name]


def fit(system: ExtendedSystem, logs: Sequence[Recording], window: float, seed: int) -> dict[str, float]:
    """Return the set fitted to logs, in two rounds: from measured start states, then from fitted ones.

    Args:
        system: The extended system.
        logs: Logs.
        window: Length of a window [s].
        seed: Of CMA-ES.
    """
    windows = cut_windows(logs, system, window)
    windows = windows.take(moving(windows)) if moving(windows).any() else windows
    if len(windows) > MOST_WINDOWS:
        windows = windows.take(np.unique(np.linspace(0, len(windows) - 1, MOST_WINDOWS).astype(int)))
    problem, names = FitProblem(system, windows), usual_names(system)
    values = {
        n: float(v) for n, v in zip(problem.names, problem.null_values(), strict=False) if np.isfinite(v)
    }
    values |= {p.name: p.value for p in system.parameters}
    values = {n: values.get(n, {"event.duration": 0.1}.get(n, 0.0)) for n in problem.names}
    state = windows.state
    for number in range(2):
        values |= _search(problem, system, windows, state, values, names, seed + number)
        state = problem.fit_states(values, windows.state)[0]
    return {n: values[n] for n in names}


def _search(
    problem: FitProblem,
    system: ExtendedSystem,
    windows: Windows,
    state: torch.Tensor,
    values: Mapping[str, float],
    names: list[str],
    seed: int,
) -> dict[str, float]:
    columns = [problem.names.index(n) for n in names]
    declared = [system.parameter(n) for n in names]
    scale = np.array([usual_scale(system.base, p.name, p.value, p.prior_sd) for p in declared])
    start = np.array([values[n] for n in names])
    low, high = (np.array([getattr(p, side) for p in declared]) for side in ("low", "high"))
    given = np.array([values[n] for n in problem.names])

    def costs(points: np.ndarray) -> np.ndarray:
        theta = np.repeat(given[None], len(points), 0)
        theta[:, columns] = np.clip(start + scale * points, low, high)
        nuisance = problem.nuisances.none()[None].expand(len(points), -1)
        shown = problem.predict(theta, state[None].expand(len(points), -1, -1), nuisance)
        found = ((windows.value - shown) * problem.weight).square().sum((1, 2, 3)).numpy()
        # A point beyond its bounds is moved to them, at a price, as usual with this method.
        beyond = ((start + scale * points - theta[:, columns]) / scale) ** 2
        return np.where(np.isfinite(found), found, 1e30) * (1.0 + 1e-3 * beyond.sum(1))

    options = {"seed": seed % 2**31 + 1, "verbose": -9, "maxiter": GENERATIONS, "tolfun": 1e-3}
    search = cma.CMAEvolutionStrategy(np.zeros(len(names)), SPREAD, options)
    while not search.stop():
        points = search.ask()
        search.tell(points, costs(np.array(points)).tolist())
    best = np.clip(start + scale * np.asarray(search.result.xbest), low, high)
    return dict(zip(names, best.tolist(), strict=True))
