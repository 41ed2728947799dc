"""Every agent is trained, loaded and compared by the same commands."""

import pytest
from hydra.errors import HydraException

from deepkoco.runs.agents import AGENTS
from deepkoco.runs.hydra_command import CONFIGS
from experiments.benchmarks.training_benchmark import read_settings
from experiments.studies.learning.comparison.style import METHODS

ON_POLICY = {"ppo"}
"""Agents that learn from an episode once, and so need many times as many."""

TAUGHT = {"imitation"}
"""Agents that learn from answers of a teacher, a question at a time."""


@pytest.mark.parametrize("agent", AGENTS)
def test_an_agent_has_typed_settings_a_name_and_a_colour(agent):
    config = read_settings(f"agent={agent}", "task=manipulator")
    config.check()
    config.agent.check()
    assert config.agent.name == agent
    with pytest.raises(HydraException):
        read_settings(f"agent={agent}", "agent.learning_rate=fast")
    with pytest.raises(HydraException):
        read_settings(f"agent={agent}", "agent.colour=red")
    assert agent in METHODS


@pytest.mark.parametrize("agent", [name for name in AGENTS if name not in ON_POLICY | TAUGHT])
def test_agents_that_keep_what_they_saw_get_as_many_episodes_of_the_manipulator(agent):
    episodes = read_settings(f"agent={agent}", "task=manipulator").agent.total_episodes
    assert episodes == read_settings("task=manipulator").agent.total_episodes


def test_what_an_agent_needs_of_a_task_names_an_agent_and_a_task():
    tasks = {path.stem for path in (CONFIGS / "task").glob("*.yaml")}
    known = {f"{agent}_{task}" for agent in AGENTS for task in tasks}
    assert {path.stem for path in (CONFIGS / "agent_on_task").glob("*.yaml")} <= known
    assert {path.stem for path in (CONFIGS / "agent").glob("*.yaml")} == set(AGENTS)


def test_methods_have_colours_of_their_own():
    assert len({style.colour for style in METHODS.values()}) == len(METHODS)
