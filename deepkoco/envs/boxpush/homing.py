"""How an episode of box pushing ends on a machine: the arm goes home, the box is put back, the tool comes down."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepkoco.engines.boxpush.retreat import DONE, LIFT, LOWER, OVER
from deepkoco.engines.boxpush.world import box_state
from deepkoco.envs.boxpush.boxpush_graph import BoxPushOptions, box_push_graph, box_push_start
from deepkoco.graph import BatchedRuntime, draw_timing

LONGEST = 6.0
"""That an arm may take for each half of the way [s]."""


class HomingError(RuntimeError):
    """The arm did not get home."""


@dataclass(frozen=True)
class ArmState:
    """Of the joints, (B, 6) each.

    Attributes:
        angles: [rad].
        speeds: [rad/s].
        goals: That the servos were sent last [rad].
    """

    angles: Tensor
    speeds: Tensor
    goals: Tensor


class Homing:
    """Brings arms home by the node `Retreat` of their graph, in simulated time.

    Args:
        options: Of the graph.
    """

    def __init__(self, options: BoxPushOptions) -> None:
        self._graph = box_push_graph(options)
        self._steps = round(LONGEST * float(self._graph.node("agent").rate))
        timing = draw_timing(self._graph, torch.Generator().manual_seed(0), self._steps, 1)
        self._runtime = BatchedRuntime(self._graph, timing)
        self._idle = torch.zeros(1, options.entries, dtype=torch.float64)

    def run(self, arm: ArmState, box: Tensor, put: Tensor) -> ArmState:
        """Lift the tool, go over the home, put the box where it is wanted, lower the tool.

        Args:
            arm: Where the episode has left the arms.
            box: (B, 3) where it has left the boxes, place [m] and turn [rad].
            put: (B, 3) where they are put.

        Raises:
            HomingError: An arm takes longer than `LONGEST` for one of the two ways.
        """
        arm = self._drive(arm, box, LIFT, LOWER)
        return self._drive(arm, put, OVER, DONE)

    def _drive(self, arm: ArmState, box: Tensor, stage: int, until: int) -> ArmState:
        batch = len(box)
        start = box_push_start(self._graph, box, box[:, :2], arm.angles, arm.speeds, arm.goals)
        start["retreat"] |= {
            "active": torch.ones(batch, dtype=torch.bool),
            "stage": torch.full((batch,), stage, dtype=torch.int64),
        }
        rows = torch.zeros(batch, dtype=torch.int64).numpy()
        state, _ = self._runtime.reset({}, torch.Generator().manual_seed(0), start, rows=rows)
        for _ in range(self._steps):
            if bool((state.nodes["retreat"]["stage"] >= until).all()):
                seen = box_state(state.nodes["world"]["seen"])
                return ArmState(seen.angles, seen.speeds, state.nodes["guard"]["goals"])
            state, _ = self._runtime.step(state, self._idle.expand(batch, -1))
        late = (state.nodes["retreat"]["stage"] < until).nonzero()[0].item()
        raise HomingError(f"the arm of environment {late} is not home after {LONGEST:g} s")
