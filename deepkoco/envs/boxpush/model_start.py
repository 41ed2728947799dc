"""From observations to the state in which a model of box pushing is rolled out."""

from __future__ import annotations

from collections import deque

import numpy as np
import torch
from torch import Tensor

from deepkoco.envs.boxpush.boxpush_graph import box_push_start
from deepkoco.envs.boxpush.seat import Seen, seen_of
from deepkoco.graph import Graph
from deepkoco.graph.model.node import State

LONGEST_AGE = 4  # steps


class ModelStart:
    """Remembers what was seen and done, and says from where a model has to be rolled out.

    With delays that is the time of the newest picture of the box: arm and servos as they were then, and the actions
    since.
    Without, what was seen last is taken for the present: ``"newest"`` the newest of each sensor, or ``"one instant"``
    the arm as it was when the picture was taken, so that tool and box fit each other.

    Args:
        graph: The model.
        rate: Decisions per second [Hz].
        take: "past", "newest" or "one instant".
    """

    def __init__(self, graph: Graph, rate: float, take: str = "past") -> None:
        if take not in ("past", "newest", "one instant"):
            raise ValueError(f'take "{take}" is none of past, newest, one instant')
        self.graph, self.rate, self.take = graph, rate, take
        self.reset()

    def reset(self) -> None:
        """Forget everything at the start of an episode."""
        self._seen: deque[Tensor] = deque(maxlen=LONGEST_AGE + 1)
        self._actions: deque[np.ndarray] = deque(maxlen=LONGEST_AGE + 1)

    def see(self, observation: np.ndarray) -> None:
        """Take note of what is seen at a decision, (E, N)."""
        self._seen.append(torch.from_numpy(np.asarray(observation, np.float64)))

    def act(self, action: np.ndarray) -> None:
        """Take note of what was decided, (E, M)."""
        self._actions.append(np.asarray(action, np.float64))

    def groups(self) -> list[tuple[np.ndarray, dict[str, State], np.ndarray]]:
        """Loops whose pictures are of the same age: which, states (n, ...) by node, and the actions since (n, P, M)."""
        now = seen_of(self._seen[-1])
        age = np.round(now.age[:, 0].numpy() * self.rate).astype(int)
        back = np.minimum(age, min(LONGEST_AGE, len(self._seen) - 1))
        return [(np.flatnonzero(back == k), *self._start(back == k, int(k))) for k in np.unique(back)]

    def _start(self, which: np.ndarray, back: int) -> tuple[dict[str, State], np.ndarray]:
        chosen = torch.from_numpy(which)
        now = seen_of(self._seen[-1][chosen])
        then = seen_of(self._seen[-1 - back][chosen])
        place = now.box + now.tool
        box = torch.cat([place, torch.atan2(now.heading[:, 1:], now.heading[:, :1])], -1)
        arm: Seen = now if self.take == "newest" else then
        loops = int(which.sum())
        known = list(self._actions)
        width = len(known[-1][0]) if known else self.graph.node("agent").initial_action.numel()  # pyright: ignore[reportAttributeAccessIssue]
        kept = back if self.take == "past" else 0
        since = [action[which] for action in known[len(known) - kept :]]
        before = known[-1 - kept][which] if len(known) > kept else np.zeros((loops, width))
        if self.take != "past":
            before = np.zeros((loops, width))  # without delays nothing is under way
        # Angles are somewhat old where they were seen, too.
        angles = arm.angles if self.take == "newest" else arm.angles + arm.joint_age * arm.speeds
        start = box_push_start(
            self.graph, box, now.goal, angles, arm.speeds, arm.goals, torch.from_numpy(before)
        )
        past = np.stack(since, 1) if since else np.zeros((loops, 0, width))
        return start, past
