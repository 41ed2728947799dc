"""The film of a run: one episode, the plans made in it and what the true system does under them."""

from __future__ import annotations

import gymnasium
import numpy as np

from deepkoco.agent.policy import KoopmanPolicy
from deepkoco.analysis.measures.collect import make_envs
from deepkoco.analysis.measures.replays import ReplayError, film_episode, follow_plan
from deepkoco.analysis.page.plan_film import PlanFilm, make_film, shadow_steps
from deepkoco.analysis.run_folder import TrainedRun
from deepkoco.envs.task_factory import TaskError

MOST_STEPS = 200


def film_run(run: TrainedRun, seed: int, most_plans: int) -> tuple[PlanFilm, str]:
    """Film an episode.

    Args:
        run: The run.
        seed: Of the episode.
        most_plans: Most plans that are drawn.

    Returns:
        The film and what it shows.

    Raises:
        ReplayError: The environment cannot be drawn, or does not repeat an episode.
    """
    try:
        envs = make_envs(run, 1, render_mode="rgb_array")
    except (TaskError, gymnasium.error.Error) as error:
        raise ReplayError(f"the environment cannot be drawn: {error}") from error
    policy = KoopmanPolicy(run.model, run.planner, run.action_low, run.action_high)
    episode = film_episode(envs, policy, run.planner, run.action_low, run.action_high, seed, MOST_STEPS)
    stride = int(np.ceil(len(episode.costs) / most_plans))
    shadows = shadow_steps(run.planner.horizon)
    futures = {k: follow_plan(envs, episode, k, shadows) for k in range(0, len(episode.costs), stride)}
    envs.close()
    step = run.model.time_step
    caption = (
        f"A new episode with the plan in it: the orange shadows are where the true system would be "
        f"{', '.join(f'{h * step:.2g}' for h in shadows[:-1])} and {shadows[-1] * step:.2g} s later if it followed "
        "the plan of this moment (the environment is run again from the start for that; the latent model itself has "
        "no picture of the future). The curves are the cost paid so far, the cost that the model predicts for its "
        "plan, and the cost of the true system under the same plan; the gap between the last two is the model's "
        "error, and the controller makes a new plan at every step."
    )
    return make_film(episode, futures, step), caption
