"""What a suite is: its file, its cells and the folders of their runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import MISSING, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from deepkoco.runs.configs import CONFIGS
from deepkoco.runs.settings import ExperimentError
from deepkoco.yaml_file import read_yaml

SUITES = Path(__file__).parent / "suites"
FULL_SCORE = 1000.0


@dataclass
class ScoreRange:
    """Which costs of an episode count how much, so that tasks can be averaged."""

    zero_cost: float = MISSING
    """Cost of the score 0, such as that of random commands."""
    full_cost: float = MISSING
    """Cost of the score 1000, such as that of the optimum."""


@dataclass
class Suite:
    """Which agents learn which tasks among what, and how often."""

    name: str = MISSING
    """For folders and pages."""
    agents: dict[str, list[str]] = field(default_factory=dict)
    """Label of each agent and its own settings of deepkoco train, the first of which is agent=NAME."""
    tasks: dict[str, ScoreRange] = field(default_factory=dict)
    """Files of configs/task."""
    among: list[str] = field(default_factory=lambda: ["none"])
    """Files of configs/among: the distractors."""
    seeds: list[int] = field(default_factory=lambda: [0])
    """Of the runs."""
    settings: list[str] = field(default_factory=list)
    """Settings of deepkoco train for all runs."""


@dataclass
class Benchmark:
    """What the command takes."""

    suite: str = MISSING
    """File of experiments/benchmark/suites, or a path of one's own (.yaml)."""
    out: str = "benchmarks"
    """Folder of the runs and the table; an old one is gone on with."""
    launcher: str | None = None
    """hydra/launcher of the sweeps: "local", "ray" or "slurm"; none: one run after the other."""
    train: bool = True
    """false: only the table of what is there."""
    agents: list[str] | None = None
    """Labels of some of the suite's agents."""
    tasks: list[str] | None = None
    """Some of its tasks."""
    among: list[str] | None = None
    """Some of its distractors."""
    seeds: list[int] | None = None
    """In the place of its seeds."""
    settings: list[str] = field(default_factory=list)
    """Further settings of all runs, which belong to what is compared."""


@dataclass(frozen=True)
class Cell:
    """One run of the grid: an agent's label, a task, its distractors and a seed."""

    agent: str
    task: str
    among: str
    seed: int

    def folder(self, out: Path) -> Path:
        """Where it is trained."""
        return out / "runs" / self.agent / self.task / self.among / f"seed_{self.seed}"


def cells(suite: Suite) -> Iterator[Cell]:
    """All runs, seed by seed: what is stopped early has each method once rather than one method often."""
    for seed in suite.seeds:
        for task in suite.tasks:
            for among in suite.among:
                for agent in suite.agents:
                    yield Cell(agent, task, among, seed)


def read_arguments(arguments: Sequence[str]) -> Benchmark:
    """Read NAME=VALUE.

    Raises:
        ExperimentError: A name is unknown, or a value does not fit.
    """
    if wrong := [text for text in arguments if "=" not in text]:
        raise ExperimentError(f"{wrong[0]}: settings are given as NAME=VALUE, such as suite={wrong[0]}")
    return _typed(Benchmark, OmegaConf.from_dotlist(list(arguments)), "settings of the benchmark")


def load_suite(given: Benchmark) -> Suite:
    """Read the suite of a command, with what the command chooses of it.

    Raises:
        ExperimentError: There is no such suite, it holds what does not fit, or the command chooses what it lacks.
    """
    path = Path(given.suite) if given.suite.endswith(".yaml") else SUITES / f"{given.suite}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in SUITES.glob("*.yaml")))
        raise ExperimentError(f"suite={given.suite}: no such suite; choose from {known}, or give a file.yaml")
    suite: Suite = _typed(Suite, OmegaConf.create(read_yaml(path)), str(path))
    suite.agents = _chosen(suite.agents, given.agents, "agents")
    suite.tasks = _chosen(suite.tasks, given.tasks, "tasks")
    suite.among = list(_chosen(dict.fromkeys(suite.among), given.among, "among"))
    suite.seeds = suite.seeds if given.seeds is None else given.seeds
    suite.settings = [*suite.settings, *given.settings]
    _check(suite, path)
    return suite


def _typed(kind: type, given: Any, what: str) -> Any:
    try:
        return OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(kind), given))
    except OmegaConfBaseException as error:
        raise ExperimentError(f"{what}: {' '.join(str(error).split())}") from error


def _chosen(there: dict[str, Any], names: Sequence[str] | None, what: str) -> dict[str, Any]:
    if names is None:
        return there
    if missing := [name for name in names if name not in there]:
        raise ExperimentError(f"{what}=[{missing[0]}]: the suite has {', '.join(there)}")
    return {name: there[name] for name in names}


def _check(suite: Suite, path: Path) -> None:
    for name in ("agents", "tasks", "among", "seeds"):
        if not getattr(suite, name):
            raise ExperimentError(f"{path}: {name} is empty")
    if len(set(suite.seeds)) < len(suite.seeds) or min(suite.seeds) < 0:
        raise ExperimentError(f"{path}: seeds {suite.seeds}: give different ones of 0 or more")
    for group, names in (("task", suite.tasks), ("among", suite.among)):
        known = sorted(p.stem for p in (CONFIGS / group).glob("*.yaml"))
        if missing := [name for name in names if name not in known]:
            raise ExperimentError(
                f"{path}: no {missing[0]} in configs/{group}; choose from {', '.join(known)}"
            )
    for name, own in suite.agents.items():
        if not own or not own[0].startswith("agent="):
            raise ExperimentError(f"{path}: agents.{name}: the first of its settings is agent=NAME")
    for name, span in suite.tasks.items():
        if span.zero_cost == span.full_cost:
            raise ExperimentError(f"{path}: tasks.{name}: zero_cost and full_cost are the same")
