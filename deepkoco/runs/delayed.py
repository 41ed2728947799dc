"""Evaluation among delays: environments that have them, and agents that bridge them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gymnasium.vector import VectorEnv

from deepkoco.agent.delayed_agent import DelayedAgent
from deepkoco.agent.delayed_policy import DelayedPolicy, DelayError
from deepkoco.agent.forward_fit import ForwardFitConfig, fit_forward_model
from deepkoco.agent.replay_files import REPLAY_FOLDER, read_replay
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.agent.stored_controller import read_controller
from deepkoco.envs.delay_arguments import DelayWrapperError
from deepkoco.envs.delay_line import ExpectedDelays
from deepkoco.envs.vector_delay_wrapper import VectorDelayWrapper
from deepkoco.koopman.files.forward_files import read_forward_model, write_forward_model
from deepkoco.koopman.files.model_folder import ModelFolderError
from deepkoco.koopman.forward_model import ForwardModel, ForwardModelError
from deepkoco.output.new_folder import FolderExistsError
from deepkoco.output.whole_file import WriteError
from deepkoco.runs.settings import ExperimentError

FORWARD_FOLDER = "forward_model"
COMPENSATIONS = ("none", "measured", "law", "both")
"""Choices of `EvaluateConfig.compensate`."""
ROLLS = ("observation", "latent")
"""Choices of `EvaluateConfig.roll`."""


def add_delays(
    envs: VectorEnv, sensing_delay: Any, actuation_delay: Any, in_order: bool = True
) -> VectorDelayWrapper:
    """Put delays between environments and their agents.

    Args:
        envs: Environments.
        sensing_delay, actuation_delay, in_order: As for `DelayWrapper`.

    Raises:
        ExperimentError: A delay does not fit the environments, or observations have delays by term.
    """
    try:
        delayed = VectorDelayWrapper(envs, actuation_delay, sensing_delay, in_order=in_order)
    except DelayWrapperError as error:
        raise ExperimentError(str(error)) from error
    if list(delayed.expected_delays.sensing) != ["observation"]:
        raise ExperimentError("sensing_delay: give one delay for the whole observation")
    return delayed


def load_delayed_agent(
    folder: Path,
    envs: VectorDelayWrapper,
    compensate: str,
    roll: str,
    seed: int,
    increment_weight: float | None = None,
) -> DelayedAgent:
    """Load a trained controller that bridges the delays of environments.

    Args:
        folder: Of a finished run of DeepKoCo, or of a model.
        envs: Where it acts.
        compensate: "measured": it is told what time stamps tell, and no law; "law": the mean delays, and no time
            stamps; "both".
        roll: "observation": predict the observation, with a forward model fitted to the episodes of the run;
            "latent": roll the latent of the observed point.
        seed: Of the run, for a forward model that has to be fitted.
        increment_weight: R~ of the planner; None takes that of the run.

    Raises:
        ExperimentError: The model or its run cannot do it.
        ModelFolderError: The folder holds no readable model.
    """
    unknown = ExpectedDelays({"observation": 0.0}, 0.0)
    expected = unknown if compensate == "measured" else envs.expected_delays
    delays = expected.actuation, expected.sensing["observation"]
    policy = load_delayed_policy(folder, seed, *delays, roll, increment_weight)
    others = [policy.another() for _ in range(envs.num_envs - 1)]
    return DelayedAgent([policy, *others], measured=compensate != "law")


def load_delayed_policy(
    folder: Path,
    seed: int,
    actuation_delay: float = 0.0,
    sensing_delay: float = 0.0,
    roll: str = "observation",
    increment_weight: float | None = None,
) -> DelayedPolicy:
    """Load a trained controller that bridges delays.

    Args:
        folder: Of a finished run of DeepKoCo, or of a model.
        seed: Of the run, for a forward model that has to be fitted.
        actuation_delay: Expected time from sending a command until it acts [s].
        sensing_delay: Expected age of an observation [s].
        roll, increment_weight: As for `load_delayed_agent`.

    Raises:
        ExperimentError: The model or its run cannot do it.
        ModelFolderError: The folder holds no readable model.
    """
    stored = read_controller(
        folder, {} if increment_weight is None else {"increment_weight": increment_weight}
    )
    settings = stored.model, stored.planner, stored.action_low, stored.action_high
    try:
        forward = forward_model_of(folder, stored.model.time_step, seed) if roll == "observation" else None
        return DelayedPolicy(*settings, forward, sensing_delay, actuation_delay)
    except (DelayError, ForwardModelError) as error:
        raise ExperimentError(f"{folder}: {error}") from error


def forward_model_of(
    folder: Path, time_step: float, seed: int, config: ForwardFitConfig | None = None
) -> ForwardModel:
    """The forward model of a run: as stored there, or fitted to the episodes of its training and stored.

    Args:
        folder: Of the run.
        time_step: Seconds per step.
        seed: Of the run.
        config: How to fit it.

    Raises:
        ExperimentError: The run keeps no episodes.
        ForwardModelError: They are none of states.
    """
    place = folder / FORWARD_FOLDER
    if place.is_dir():
        return read_forward_model(place)
    iterations = len(list((folder / REPLAY_FOLDER).glob("*.pt")))
    if not iterations:
        raise ExperimentError(
            f"{folder}: holds neither a forward model nor episodes to fit one to; give the folder of a training run, "
            "or roll=latent"
        )
    episodes = read_replay(folder, iterations)
    fitted = fit_forward_model(episodes, time_step, derive_seed(seed, Purpose.FORWARD_MODEL), config)
    try:
        write_forward_model(fitted.model, place, fitted.errors)
    except (FolderExistsError, ModelFolderError, WriteError):
        if not place.is_dir():
            raise
        return read_forward_model(place)  # another evaluation was faster; the seed gave it the same
    return fitted.model
