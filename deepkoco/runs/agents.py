"""The agents that can be trained: a new one is its package, one line here and a file of configs/agent.

The baselines are known by name only, so that nothing of deepkoco imports them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from deepkoco.agent.collection import BatchController, VectorEnvFactory
from deepkoco.agent.metrics import MetricsLog, Row
from deepkoco.agent.standing import Report
from deepkoco.envs.task_factory import TaskConfig
from deepkoco.runs.settings import EvaluateConfig, ExperimentError, TrainRunConfig


class AgentSettings(Protocol):
    """What the settings of every agent have."""

    name: str
    total_episodes: int

    def check(self) -> None:
        """Raise an error of the agent's own if a value is out of range."""


class Trainer(Protocol):
    """One training run in one folder, continued where its checkpoint stands."""

    metrics: MetricsLog

    def run(self, report: Report | None = None) -> Row:
        """Train to the end, write the folder `model` and return the last row of metrics."""
        ...


class Controller(BatchController, Protocol):
    """A trained agent without exploration, in B environments at once."""

    @property
    def failures(self) -> int:
        """Decisions that could not be made."""
        ...


MakeTrainer = Callable[
    [VectorEnvFactory, Any, int, Path, VectorEnvFactory | None, Mapping[str, Any] | None], Trainer
]


@dataclass(frozen=True)
class AgentKind:
    """How an agent is set, trained and used; modules are imported when they are asked for.

    Attributes:
        settings: "module:class" of its settings.
        trainer: "module:class" of its `Trainer`.
        controller: "module:function" from (folder of a run, B) to its `Controller`.
    """

    settings: str
    trainer: str
    controller: str


def _baseline(settings: str) -> AgentKind:
    return AgentKind(
        f"baselines.config:{settings}", "baselines.training:BaselineTrainer", "baselines.policy:load_policy"
    )


AGENTS = {
    "deepkoco": AgentKind(
        "deepkoco.agent.config:TrainingConfig",
        "deepkoco.agent.training:Trainer",
        "deepkoco.agent.agent:load_agent",
    ),
    "sac": _baseline("SacConfig"),
    "sac_shared": _baseline("SharedSacConfig"),
    "deepmdp": _baseline("DeepMdpConfig"),
    "dbc": _baseline("DbcConfig"),
    "ppo": AgentKind(
        "baselines.ppo.config:PpoConfig",
        "baselines.ppo.training:PpoTrainer",
        "baselines.ppo.policy:load_policy",
    ),
    "imitation": AgentKind(
        "baselines.imitation.config:ImitationConfig",
        "baselines.imitation.training:ImitationTrainer",
        "baselines.imitation.policy:load_policy",
    ),
}


def agent_kind(name: str) -> AgentKind:
    """Look an agent up.

    Args:
        name: As in configs/agent.

    Raises:
        ExperimentError: There is no such agent.
    """
    if name not in AGENTS:
        raise ExperimentError(f'agent.name = "{name}"; choose one of {", ".join(AGENTS)}')
    return AGENTS[name]


def is_installed(name: str) -> bool:
    """Whether the package of an agent is there; a distribution may leave the baselines out."""
    return find_spec(agent_kind(name).settings.split(".")[0]) is not None


def check_installed(name: str) -> None:
    """Check that an agent can be used here.

    Args:
        name: As in configs/agent.

    Raises:
        ExperimentError: There is no such agent, or its package is not installed.
    """
    if not is_installed(name):
        package = agent_kind(name).settings.split(".")[0]
        raise ExperimentError(
            f'agent = "{name}": its package "{package}" is not installed; install deepkoco from a checkout or from '
            f"its wheel, which hold it, or choose another agent: {', '.join(filter(is_installed, AGENTS))}"
        )


def settings_class(name: str) -> type[Any]:
    """The dataclass of an agent's settings; see `agent_kind`."""
    check_installed(name)
    return _found(agent_kind(name).settings)


def trainer_class(name: str) -> MakeTrainer:
    """What makes an agent's trainer; see `agent_kind`."""
    check_installed(name)
    return _found(agent_kind(name).trainer)


def load_controller(name: str, run: Path, count: int) -> Controller:
    """Load a trained agent.

    Args:
        name: Of the agent.
        run: Folder of a finished run.
        count: B, environments that it acts in at once.
    """
    check_installed(name)
    return _found(agent_kind(name).controller)(run, count)


def register() -> None:
    """Make the schemas of all settings known to Hydra."""
    store = ConfigStore.instance()
    # Without an agent: that of one cannot be merged with the typed settings of another.
    store.store(name="train_schema", node=TrainRunConfig(agent=MISSING))
    store.store(name="evaluate_schema", node=EvaluateConfig)
    store.store(group="task", name="task_schema", node=TaskConfig)
    for name in filter(is_installed, AGENTS):
        store.store(group="agent", name=f"{name}_schema", node=settings_class(name))


def _found(place: str) -> Any:
    module, name = place.split(":")
    return getattr(import_module(module), name)
