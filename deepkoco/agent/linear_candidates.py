"""Linear models of a run's own episodes, which compete with its networks: the run ends with nothing worse."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from deepkoco.agent.buffer import Episode
from deepkoco.agent.config import TrainingConfig
from deepkoco.agent.first_episodes import fit_linear
from deepkoco.agent.fitted_settings import linear_horizon
from deepkoco.agent.task_scale import TaskScale
from deepkoco.koopman.exported import Array
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel, LiftedModelError


def fit_candidates(
    config: TrainingConfig,
    episodes: Sequence[Episode],
    alone: int,
    action_weight: float | Array,
    seed: int,
    units: TaskScale | None = None,
) -> list[LiftedLinearModel]:
    """EDMDc of what has been collected.

    Where a task is nearly linear, a network that has to find this out may do no better. After the first iteration the
    reference of the comparison, which is fitted to the episodes of noise alone, is among the candidates; the others
    learn the cost that the network does, and weigh its errors so. Later the last episodes come first, for the dynamics
    are fitted to a limited number and these show the task where it is controlled.

    Args:
        config: Hyper-parameters, as the first episodes call for them.
        episodes: As they were recorded, with observations that are states.
        alone: How many of them noise alone has moved; 0 after later iterations.
        action_weight: R.
        seed: Of the draws, that of the reference.
        units: Those of the network; None for none.

    Returns:
        The models that could be fitted.
    """
    relative = config.relative_cost or None
    choices = [(episodes[:alone], None), (episodes[:alone], relative)] if alone else []
    choices.append((episodes if alone else episodes[::-1], relative))
    found = []
    for chosen, share in choices:
        with suppress(LiftedModelError):
            found.append(
                fit_linear(
                    chosen,
                    config.model.time_step,
                    action_weight,
                    linear_horizon(config),
                    seed,
                    share,
                    None if share is None else units,
                )
            )
    return found
