"""Initial positions that a cause makes count, where a log shows the speed of a joint without its position.

Without a weight, a spring or a detent nothing depends on the position of such a joint, so the initial positions of the
windows are no parameters of the refit. A cause whose load depends on the position frees them: a weak spring whose
centre is far away is another constant load in each window. Detents have another phase in each. These are as many
parameters as there are windows, and the penalty must charge them, or noise is taken for a detent and any slow change of
a friction for a spring. Positions do not tie the windows together either: over thousands of turns the scale of no
tachometer is known well enough to tell the phase.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch

from deepkoco.diagnose.causes import Cause
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.systems import Motion, System

PLACES = (0.0, 0.37, 1.1, 2.9)  # positions that are compared [rad or m]
ALIKE = 1e-9  # relative difference of accelerations below which they are equal


def with_freed_positions(problem: FitProblem, reference: Fit, causes: Sequence[Cause]) -> list[Cause]:
    """Return the causes, each with the number of initial positions that count with it and not in the reference.

    Args:
        problem: The windows.
        reference: Fit of the baseline with the causes accepted so far.
        causes: Causes at their places.
    """
    hidden = hidden_positions(problem.windows)
    if not hidden:
        return list(causes)
    system, values = problem.system, reference.values
    free = {j: count for j, count in hidden.items() if not depends_on_position(system, values, j)}
    declared = {p.name: p for p in system.parameters}
    found = []
    for cause in causes:
        known = [declared[n] for n in cause.free if n in declared]
        size = {
            p.name: values[p.name] + (p.prior_sd if values[p.name] + p.prior_sd <= p.high else -p.prior_sd)
            for p in known
        }
        count = sum(n for j, n in free.items() if depends_on_position(system, {**values, **size}, j))
        # An elastic drive is charged for more states of each window already.
        found.append(replace(cause, states=max(cause.states, count)))
    return found


def hidden_positions(windows: Windows) -> dict[int, int]:
    """Return the joints of which windows show the speed without the position -> the number of these windows."""
    joints = windows.state.shape[1] // 2
    shown = {s: windows.valid[:, c].any(-1) for c, s in enumerate(windows.shows)}
    none = torch.zeros(len(windows), dtype=torch.bool)
    counts = {j: int((shown.get(j + joints, none) & ~shown.get(j, none)).sum()) for j in range(joints)}
    return {j: count for j, count in counts.items() if count}


def depends_on_position(system: System, values: Mapping[str, float], joint: int) -> bool:
    """Return whether any acceleration depends on the position of a joint."""
    law = system.accelerations({n: torch.tensor(v, dtype=torch.float64) for n, v in values.items()})
    places = torch.tensor(PLACES, dtype=torch.float64)
    still = torch.zeros_like(places)
    angles = tuple(places if j == joint else still + 0.2 for j in range(system.joints))
    speeds = tuple(still + 0.7 + 0.1 * j for j in range(system.joints))
    efforts = tuple(still + 0.3 * c.high + 0.7 * max(c.low, -c.high) for c in system.commands)
    time = torch.zeros((), dtype=torch.float64)
    smoothing = tuple(still + 0.05 for _ in range(system.joints))
    for acceleration in law(Motion(angles, speeds, efforts, None, time, smoothing)):
        row = acceleration.detach().expand(len(PLACES))
        if bool((row - row[0]).abs().max() > ALIKE * row.abs().max().clamp(min=1e-12)):
            return True
    return False
