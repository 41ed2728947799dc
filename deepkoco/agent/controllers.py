"""What acts during a run: the network as it is, a linear model beside it, and what the run ends with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.experience import Experience
from deepkoco.agent.exploration import OrnsteinUhlenbeck
from deepkoco.agent.learner import Learner
from deepkoco.agent.side_by_side import SideBySide
from deepkoco.koopman.export import export_model
from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel
from deepkoco.planning.config import PlannerConfig


class Controllers:
    """Makes controllers of the averaged weights, or of linear models, in the units of the environment."""

    def __init__(self, experience: Experience, learner: Learner, low: Array, high: Array) -> None:
        """Keep what controllers are made of.

        Args:
            experience: Knows the units, and the settings of the planner.
            learner: Has the averaged weights.
            low: a_min (M,).
            high: a_max (M,).
        """
        self._experience, self._learner, self._limits = experience, learner, (low, high)

    def result(
        self, linear: LiftedLinearModel | None = None
    ) -> tuple[ExportedModel | LiftedLinearModel, PlannerConfig]:
        """A model and its planner.

        Args:
            linear: The linear model that did better than all weights; None takes the averaged weights.
        """
        own = self._experience
        if linear is not None:
            return linear, own.linear_planner
        return own.exported(export_model(self._learner.averaged)), own.planner

    def agent(
        self, count: int, seed: int, linear: LiftedLinearModel | None = None, **choices: Any
    ) -> VectorAgent:
        """The controller of `result` in a batch of environments.

        Args:
            count: B.
            seed: Of planners that draw samples.
            linear: See `result`.
            **choices: Further arguments of `VectorAgent`.
        """
        return VectorAgent(*self.result(linear), *self._limits, count, seed=seed, **choices)

    def exploring(
        self,
        count: int,
        seed: int,
        noise: Callable[[int, float], OrnsteinUhlenbeck],
        linear: LiftedLinearModel | None,
    ) -> VectorAgent | SideBySide:
        """What collects: the network; beside it a linear model, as long as no network did better.

        A network that cannot balance a pole yet falls at once and sees hardly anything else.

        Args:
            count: B.
            seed: Of planners that draw samples.
            noise: Makes the exploration of so many environments with such a floor.
            linear: The linear model that did better than all weights so far.
        """
        floor = self._experience.noise_floor
        if linear is None or count < 2:
            return self.agent(count, seed, noise=noise(count, floor))
        odd = count // 2
        network = self.agent(count - odd, seed, noise=noise(count - odd, floor))
        return SideBySide(network, self.agent(odd, 0, linear, noise=noise(odd, floor)))
