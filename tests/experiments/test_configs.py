"""The files of configs/task fit the environments they name."""

import gymnasium
import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from omegaconf.errors import MissingMandatoryValue

from deepkoco.runs.agents import register
from deepkoco.runs.environments import make_factory
from deepkoco.runs.hydra_command import CONFIGS
from deepkoco.runs.settings import TrainRunConfig

OWN = sorted(
    {path.stem for path in (CONFIGS / "task").glob("*.yaml")} - {"gymnasium", "robot"}
)  # these two need more than their file


def read(*overrides: str) -> TrainRunConfig:
    register()
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        config = OmegaConf.to_object(compose("train", list(overrides)))
    assert isinstance(config, TrainRunConfig)
    return config


@pytest.mark.parametrize("name", OWN)
def test_every_environment_steps_in_the_time_that_the_model_takes_for_a_step(name):
    config = read(f"task={name}")
    assert config.task.name == name
    config.agent.check()
    envs = make_factory(config.task, "copies")(2, 0)
    observation, _ = envs.reset(seed=0)
    assert envs.step(envs.action_space.sample() * 0.0)[0].shape == observation.shape
    inner = envs.unwrapped
    one = inner.envs[0] if hasattr(inner, "envs") else inner
    step = one.get_wrapper_attr("dt") if hasattr(one, "get_wrapper_attr") else one.dt
    assert config.agent.model.time_step == pytest.approx(step)
    space = envs.single_action_space
    assert isinstance(space, gymnasium.spaces.Box)
    if hasattr(inner, "task"):
        np.testing.assert_allclose(space.high, inner.task.command_limits)
    envs.close()


def test_any_gymnasium_id_is_taken_without_arguments_of_ours():
    config = read("task=gymnasium", "task.id=MountainCarContinuous-v0", "agent.model.time_step=1")
    envs = make_factory(config.task, config.distractors)(2, 0)
    assert envs.reset(seed=0)[0].shape == (2, 2)
    assert config.agent.model.time_step == 1
    with pytest.raises(MissingMandatoryValue, match="id"):
        read("task=gymnasium")


def test_settings_given_by_the_user_win_over_those_of_the_environment():
    assert read("task=disk_pendulum", "agent.model.time_step=0.04").agent.model.time_step == 0.04


PROFILES = {
    "small": "dbc",
    "small_images": "dbc",
    "tuned": "deepkoco",
    "few_episodes": "deepkoco",
    "far_goals": "deepkoco",
}


def test_every_profile_fits_its_agent_and_gives_way_to_the_user():
    assert {path.stem for path in (CONFIGS / "profile").glob("*.yaml")} == set(PROFILES)
    for profile, agent in PROFILES.items():
        plain, changed = (read(f"agent={agent}", *more) for more in ((), (f"+profile={profile}",)))
        changed.agent.check()
        assert changed.agent != plain.agent
        assert (
            read(f"agent={agent}", f"+profile={profile}", "agent.total_episodes=77").agent.total_episodes
            == 77
        )
