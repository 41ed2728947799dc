"""Sparse regression of the missing torque on a library of terms (SINDy's sequentially thresholded least squares)."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import System
from experiments.studies.diagnosis.hidden_cause.entrants.missing import (
    Missing,
    missing_torque,
    simulation_with,
)
from experiments.studies.diagnosis.hidden_cause.entrants.naming import USUAL, load_of
from experiments.studies.diagnosis.hidden_cause.kinds import NOTHING, UNKNOWN
from experiments.studies.diagnosis.hidden_cause.questions import Answer, Handed

STLSQ = import_module("pysindy").STLSQ  # of the extra `rivals`
SHARP = {"rad": 0.05, "m": 0.01}  # speed over which a sign changes [rad/s, m/s]
LEAST = 0.5  # of the usual share: a smaller term is left out
MUCH = 2.0  # times the usual share is left over from which something unknown is there
Term = Callable[[Tensor, Tensor, Tensor], Tensor]


class SparseRegression:
    """STLSQ of `pysindy` for each joint; names the term that alone explains most of the missing torque.

    It is a cause from the usual 4 % of the load on (`naming`), as a root mean square. With healthy logs, what a
    regression of these explains is taken off first. "unknown" where no term is large, but twice as much is left,
    averaged over ten samples.
    """

    name = "sparse"

    def answer(self, handed: Handed) -> Answer:
        """Regress the missing torque of the log."""
        system = handed.system
        terms = [library(system, j) for j in range(system.joints)]
        seen = missing_torque(system, handed.log)
        found = [_regress(system, seen, j, terms[j]) for j in range(system.joints)]
        usual = [np.zeros_like(x) for x in found]
        if handed.healthy:
            healthy = missing_torque(system, handed.healthy)
            usual = [_regress(system, healthy, j, terms[j]) for j in range(system.joints)]
        sizes, left = {}, 0.0
        for j in range(system.joints):
            columns, load = _columns(seen, terms[j]), load_of(system, j)
            # Terms that are nearly alike cancel each other, so each is asked alone what it explains.
            changed = seen.torque[:, j] - columns @ usual[j]
            alone = np.abs(columns.T @ changed) / np.sqrt((columns**2).sum(0).clip(1e-300) * len(columns))
            for name, size in zip(terms[j], alone / load, strict=True):
                sizes[name] = max(float(size), sizes.get(name, 0.0))
            rest = np.convolve(seen.torque[:, j] - columns @ found[j], np.ones(10) / 10.0, "valid")
            left = max(left, float(np.sqrt((rest**2).mean())) / load)
        best = max(sizes, key=lambda n: sizes[n])
        name = best if sizes[best] >= USUAL else UNKNOWN if left > MUCH * USUAL else NOTHING

        def torque(q: Tensor, v: Tensor, u: Tensor) -> Tensor:
            weights = [torch.from_numpy(x) for x in found]
            parts = []
            for j in range(system.joints):
                parts.append(sum(w * f(q, v, u) for w, f in zip(weights[j], terms[j].values(), strict=True)))
            return torch.stack(torch.broadcast_tensors(*parts), -1)

        note = f"{best} {sizes[best]:.3g} of the load, {left:.3g} left"
        return Answer(name, (name,), simulation_with(system, torque), note)


def library(system: System, joint: int) -> dict[str, Term]:
    """Terms of a joint's missing torque by the cause that they stand for."""
    sharp = SHARP[system.state_units[joint]]

    def at(kind: str) -> str:
        return system.at_joint(kind, joint)

    terms: dict[str, Term] = {
        at("torque_bias"): lambda q, v, u: torch.ones_like(q[..., joint]),
        at("spring"): lambda q, v, u: q[..., joint],
        at("viscous"): lambda q, v, u: v[..., joint],
        at("coulomb"): lambda q, v, u: torch.tanh(v[..., joint] / sharp),
        at("quadratic"): lambda q, v, u: v[..., joint] * v[..., joint].abs(),
    }
    if system.state_units[joint] == "rad":
        # Gravity on the links from this joint on: the sum of the angles so far.
        turns = [k for k in range(joint + 1) if system.state_units[k] == "rad"]
        terms["payload"] = lambda q, v, u: torch.cos(q[..., turns].sum(-1))
        terms["tilt"] = lambda q, v, u: torch.sin(q[..., turns].sum(-1))
    for k, driven in enumerate(system.command_joints):
        if driven == joint:
            terms[at("gain")] = lambda q, v, u, k=k: u[..., k]
        else:
            name = f"crosstalk({system.joint_names[driven]} to {system.joint_names[joint]})"
            terms[name] = lambda q, v, u, k=k: u[..., k]
    return terms


def _columns(seen: Missing, terms: dict[str, Term]) -> np.ndarray:
    q, v, u = (torch.from_numpy(np.ascontiguousarray(x)) for x in (seen.q, seen.v, seen.u))
    return np.column_stack([f(q, v, u).numpy() for f in terms.values()])


def _regress(system: System, seen: Missing, joint: int, terms: dict[str, Term]) -> np.ndarray:
    """(T,) coefficients; the threshold is a root mean square torque."""
    columns = _columns(seen, terms)
    size = np.sqrt((columns**2).mean(0)).clip(1e-12)
    least = LEAST * USUAL * load_of(system, joint)
    model = STLSQ(threshold=least, alpha=1e-6, max_iter=20)
    model.fit(columns / size, seen.torque[:, joint : joint + 1])
    return np.asarray(model.coef_)[0] / size
