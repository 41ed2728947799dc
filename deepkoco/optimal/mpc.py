"""Model predictive control on the true model: plan over a horizon, act, plan anew from where that led."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from deepkoco.optimal.cross_entropy import CrossEntropyConfig, cross_entropy_guesses
from deepkoco.optimal.ilqr import ILQR, Curvature, Plan, true_curvature
from deepkoco.optimal.true_model import TrueModel


@dataclass(frozen=True)
class PredictiveConfig:
    """Settings of the controller.

    Attributes:
        horizon: Steps that are planned.
        first_iterations: Of iLQR for the first plan of an episode, from each of the guesses.
        iterations: Of iLQR for every later plan, from the rest of the plan before.
        search: For guesses of the first plan.
        seed: Of that search.
    """

    horizon: int = 60
    first_iterations: int = 15
    iterations: int = 2
    search: CrossEntropyConfig = field(default_factory=CrossEntropyConfig)
    seed: int = 0


class ModelPredictiveControl:
    """Nonlinear MPC by iLQR, for a batch of episodes at once.

    Swinging up has many local minima. The first plan of an episode is therefore the best of several: from no
    action, from braking, and from what a search by samples finds.

    Args:
        model: To plan on.
        config: Horizon and iterations.
        curvature: See `ILQR`.
    """

    def __init__(
        self,
        model: TrueModel,
        config: PredictiveConfig | None = None,
        curvature: Curvature = true_curvature,
    ) -> None:
        self.model, self.config = model, config or PredictiveConfig()
        self._solver = ILQR(model, curvature)
        self._rest: Tensor | None = None

    def reset(self) -> None:
        """Forget the plans: new episodes begin."""
        self._rest = None

    def act(self, state: Tensor) -> Tensor:
        """Actions (B, M) for states (B, S)."""
        config = self.config
        if self._rest is None or len(self._rest) != len(state):
            plan = self._first(state)
        else:
            plan = self._solver.solve(state, self._rest, config.iterations)
        self._rest = torch.cat([plan.actions[:, 1:], plan.actions[:, -1:]], 1)
        return plan.actions[:, 0]

    def __call__(self, state: Tensor, step: int) -> Tensor:
        """`act`, as a controller of `play`."""
        return self.act(state)

    def _first(self, state: Tensor) -> Plan:
        guesses = torch.cat(self._guesses(state))
        count = len(guesses) // len(state)
        plan = self._solver.solve(state.repeat(count, 1), guesses, self.config.first_iterations)
        best = plan.cost.reshape(count, -1).argmin(0)
        return plan.take(best * len(state) + torch.arange(len(state)))

    def _guesses(self, state: Tensor) -> list[Tensor]:
        """First guesses, each (B, H, M)."""
        model, horizon = self.model, self.config.horizon
        joints = slice(model.angles, 2 * model.angles)
        now, brakes = state, []
        for _ in range(horizon):
            brakes.append(torch.where(now[:, joints] > 0, model.low, model.high))
            now = model.step(now, brakes[-1])
        generator = torch.Generator().manual_seed(self.config.seed)
        found = cross_entropy_guesses(
            model,
            lambda x, a: self._solver.roll_out(x, a).cost,
            state,
            horizon,
            self.config.search,
            generator,
        )
        return [torch.zeros_like(found[0]), torch.stack(brakes, 1), *found]
