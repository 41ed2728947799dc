"""Studies of one kind: SAC trained in variants of a simulator, evaluated on a unit; resumable run by run.

A run is one training: a system, a condition (what its simulator knows) and a seed. Its folder holds
``learning.csv``, ``policy.pt`` when it is trained, and ``evaluation.csv`` when it is evaluated; what is there is
not done again.
"""

from __future__ import annotations

import json
import sys
import textwrap
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import torch

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.envs.unit_env import UnitEnv
from deepkoco.output.whole_file import whole_file, write_whole_text
from deepkoco.runs.settings import ExperimentError
from deepkoco.runs.unit_trials import UPRIGHT_ANGLE
from deepkoco.unit import make_unit
from experiments.plumbing.provenance import as_markdown

PLACES = {"simulator": "its own simulator", "unit": "unit", "unit_wall": "unit, wall clock"}
NETWORK = (64, 64)
EVALUATION_SEED = 10_000


@dataclass(frozen=True)
class Bench:
    """A system, its environment and the unit that stands for the real one.

    Attributes:
        environment: Gymnasium id.
        unit: Arguments of `deepkoco.unit.make_unit` besides the system.
        steps: Environment steps of a training.
        updates_every: Environment steps for each gradient step.
        gamma: Discount of SAC, per step.
        action_history: Past actions in the observation, the same in every condition.
    """

    environment: str
    unit: Mapping[str, Any]
    steps: int
    updates_every: int = 1
    gamma: float = 0.98
    action_history: int = 3


@dataclass(frozen=True)
class Study:
    """What is compared.

    Attributes:
        name: Name of the study, of its files too.
        title: What the figure says above.
        benches: By name of the system.
        conditions: Label -> system -> settings of the simulator that the agent is trained in.
    """

    name: str
    title: str
    benches: Mapping[str, Bench]
    conditions: Mapping[str, Mapping[str, Mapping[str, Any]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Run:
    """One training."""

    system: str
    condition: str
    seed: int

    @property
    def name(self) -> str:
        return f"{self.system}-{self.condition.replace(' ', '_')}-{self.seed}"


def run_study(
    study: Study,
    out: Path,
    seeds: Sequence[int],
    systems: Sequence[str],
    conditions: Sequence[str],
    steps: int | None = None,
    episodes: int = 20,
    wall_episodes: int = 0,
    report: Callable[[str], None] = print,
) -> pd.DataFrame:
    """Train and evaluate what is not done yet, then write table and figure.

    Args:
        study: What is compared.
        out: Folder; made, or gone on with where the same study has begun it.
        seeds, systems, conditions: Which runs.
        steps: Environment steps of a training; None takes the bench's.
        episodes: Evaluation episodes on the unit in virtual time and in the simulator.
        wall_episodes: Evaluation episodes on the unit in wall-clock time.
        report: Told a line for every run.

    Returns:
        The episodes of all finished runs.

    Raises:
        ExperimentError: The folder holds something else, or a name is unknown.
    """
    for what, names, known in (
        ("system", systems, study.benches),
        ("condition", conditions, study.conditions),
    ):
        unknown = [name for name in names if name not in known]
        if unknown:
            raise ExperimentError(f'{what} "{unknown[0]}" is none of {", ".join(known)}')
    _claim(study, out, {"steps": steps, "episodes": episodes})
    # Seed by seed, so that a study that is stopped compares all conditions on fewer seeds.
    runs = [Run(system, condition, seed) for seed in seeds for system in systems for condition in conditions]
    for place, run in enumerate(runs, 1):
        folder = out / "runs" / run.name
        begun = time.process_time()
        done = (folder / "evaluation.csv").exists()
        if not done:
            _train_and_evaluate(study, run, folder, steps, episodes)
        table: Any = pd.read_csv(folder / "evaluation.csv")
        costs = table.groupby("place")["cost"].mean()
        spent = "there already" if done else f"{time.process_time() - begun:.0f} CPU s"
        report(
            f"[{place}/{len(runs)}] {run.name}: cost {costs['simulator']:.1f} in its simulator, "
            f"{costs['unit']:.1f} on the unit ({spent})"
        )
        if wall_episodes and not (folder / "wall.csv").exists():
            _evaluate_on_wall_clock(study, run, folder, wall_episodes)
    return summarize(study, out)


def summarize(study: Study, out: Path) -> pd.DataFrame:
    """Write ``episodes.csv``, ``summary.csv``, the figure and the provenance from the finished runs."""
    files = sorted((out / "runs").glob("*/evaluation.csv")) + sorted((out / "runs").glob("*/wall.csv"))
    episodes: Any = pd.concat([pd.read_csv(file) for file in files], ignore_index=True)
    episodes = episodes.sort_values(["system", "condition", "seed", "place", "episode"])
    by_seed: Any = episodes.groupby(["system", "condition", "place", "seed"])[["cost", "upright"]].mean()
    rows = []
    for key, group in by_seed.groupby(["system", "condition", "place"]):
        mean, low, high = mean_with_band(group["cost"].to_numpy())
        rows.append((*key, len(group), mean, low, high, group["upright"].mean()))
    columns = ["system", "condition", "place", "seeds", "cost", "low", "high", "upright"]
    summary = pd.DataFrame(rows, columns=columns)
    _write_table(out / "episodes.csv", episodes)
    _write_table(out / "summary.csv", summary)
    _write(out / "PROVENANCE.md", as_markdown() + "\n")
    _draw(study, summary, by_seed.reset_index(), out / f"{study.name}.png")
    return episodes


def _claim(study: Study, out: Path, settings: Mapping[str, Any]) -> None:
    """Make the folder, or check that it belongs to this study."""
    content = {"study": study.name, **settings, "benches": {k: asdict(v) for k, v in study.benches.items()}}
    content["conditions"] = study.conditions
    text = json.dumps(content, indent=1, default=str) + "\n"
    file = out / "study.json"
    if file.exists():
        if file.read_text(encoding="utf-8") != text:
            raise ExperimentError(f"{out}: holds a study with other settings; choose another --out")
        return
    if out.exists() and any(out.iterdir()):
        raise ExperimentError(f"{out}: is not empty and holds no study; choose another --out")
    out.mkdir(parents=True, exist_ok=True)
    _write(file, text)


def _write(path: Path, text: str) -> None:
    write_whole_text(path, text)


def _write_table(path: Path, table: pd.DataFrame) -> None:
    _write(path, str(table.to_csv(index=False, float_format="%.6g")))


def _simulator(study: Study, run: Run) -> gymnasium.Env:
    bench = study.benches[run.system]
    settings = study.conditions[run.condition][run.system]
    return gymnasium.make(
        bench.environment, noise=True, action_history=bench.action_history, **dict(settings)
    )


def _unit(study: Study, run: Run, clock: str) -> UnitEnv:
    bench = study.benches[run.system]
    spec = gymnasium.spec(bench.environment)
    return UnitEnv(
        make_unit(run.system, **dict(bench.unit)), clock, spec.max_episode_steps or 200,
        action_units="normalized", action_history=bench.action_history,
    )  # fmt: skip


def _agent(study: Study, run: Run, env: gymnasium.Env, steps: int) -> Any:
    # The bench extra, only where an agent is trained or run.
    from stable_baselines3 import SAC  # pyright: ignore[reportMissingImports]

    torch.set_num_threads(1)
    bench = study.benches[run.system]
    return SAC(
        "MlpPolicy", env, learning_rate=1e-3, buffer_size=steps, learning_starts=500, batch_size=128,
        gamma=bench.gamma, train_freq=bench.updates_every, gradient_steps=1, seed=run.seed, device="cpu",
        policy_kwargs={"net_arch": list(NETWORK)}, stats_window_size=10**6,
    )  # fmt: skip


def _train_and_evaluate(study: Study, run: Run, folder: Path, steps: int | None, episodes: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "policy.pt").exists():
        _train(study, run, folder, steps or study.benches[run.system].steps)
    with _simulator(study, run) as simulator, _unit(study, run, "simulated") as unit:
        agent = _trained(study, run, folder, simulator)
        worlds = {"simulator": simulator, "unit": unit}
        parts = [_evaluate(agent, world, episodes).assign(place=place) for place, world in worlds.items()]
    _write_table(folder / "evaluation.csv", pd.concat(parts).assign(**asdict(run)))


def _train(study: Study, run: Run, folder: Path, steps: int) -> None:
    with _simulator(study, run) as env:
        agent = _agent(study, run, env, steps)
        agent.learn(steps)
    returns = [(round(i["l"]), i["r"]) for i in agent.ep_info_buffer]
    learning = pd.DataFrame({"steps": np.cumsum([n for n, _ in returns]), "cost": [-r for _, r in returns]})
    _write_table(folder / "learning.csv", learning)
    with whole_file(folder / "policy.pt") as partial, partial.open("wb") as file:
        torch.save(agent.policy.state_dict(), file)


def _trained(study: Study, run: Run, folder: Path, env: gymnasium.Env) -> Any:
    agent = _agent(study, run, env, 1)
    agent.policy.load_state_dict(torch.load(folder / "policy.pt", weights_only=True))
    return agent


def _evaluate_on_wall_clock(study: Study, run: Run, folder: Path, episodes: int) -> None:
    with _simulator(study, run) as simulator, _unit(study, run, "wall") as unit:
        agent = _trained(study, run, folder, simulator)
        table = _evaluate(agent, unit, episodes).assign(place="unit_wall", **asdict(run))
    _write_table(folder / "wall.csv", table)


def _evaluate(agent: Any, env: gymnasium.Env, episodes: int) -> pd.DataFrame:
    """Run the mean action from start states that are the same for every agent, in the simulator and on the unit."""
    rows, task, system = [], env.unwrapped.task, env.unwrapped.system  # type: ignore[attr-defined]
    for episode in range(episodes):
        seed = EVALUATION_SEED + episode
        start = task.start(system, 1, torch.Generator().manual_seed(seed))[0].numpy()
        observation, _ = env.reset(seed=seed, options={"initial_state": start})
        cost, angles, over = 0.0, [], False
        while not over:
            action, _ = agent.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, info = env.step(action)
            cost -= float(reward)
            angles.append(abs(info["angle_from_upright"]))
            over = terminated or truncated
        last = float(np.mean(angles[-len(angles) // 4 :]))
        timing = env.timing if isinstance(env, UnitEnv) else {}
        rows.append((episode, cost, last < UPRIGHT_ANGLE, last, int(timing.get("overruns", 0))))
    return pd.DataFrame(rows, columns=["episode", "cost", "upright", "last_angle", "overruns"])


def _draw(study: Study, summary: Any, by_seed: Any, path: Path) -> None:
    systems = [name for name in study.benches if name in set(summary["system"])]
    figure, axes = plt.subplots(
        1, len(systems), figsize=(3.0 + 4.0 * len(systems), 3.8), layout="constrained", squeeze=False
    )
    conditions = list(study.conditions)
    for axis, system in zip(axes[0], systems, strict=True):
        places = [p for p in PLACES if p in set(summary[summary["system"] == system]["place"])]
        for i, condition in enumerate(conditions):
            own = summary[(summary["system"] == system) & (summary["condition"] == condition)]
            own = own.set_index("place")
            there = [p for p in places if p in own.index]
            x = np.array([places.index(p) for p in there]) + 0.8 * ((i + 0.5) / len(conditions) - 0.5)
            axis.bar(
                x, own.loc[there, "cost"], 0.75 / len(conditions), color=f"C{i}", alpha=0.5, label=condition
            )
            for position, place in zip(x, there, strict=True):
                dots = by_seed[
                    (by_seed["system"] == system)
                    & (by_seed["condition"] == condition)
                    & (by_seed["place"] == place)
                ]
                axis.plot([position] * len(dots), dots["cost"], "o", color=f"C{i}", markersize=4)
        axis.set_xticks(range(len(places)), [PLACES[p] for p in places])
        axis.set(title=system.replace("_", " "), ylabel="cost of an episode, mean and seeds")
        axis.grid(alpha=0.3, axis="y")
    # Outside of the axes, where it covers no seed.
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(), loc="outside right center", fontsize=8, title="trained"
    )
    figure.suptitle(textwrap.fill(study.title, 14 + 34 * len(systems)))
    with whole_file(path) as partial:
        figure.savefig(partial, dpi=150, format="png")
        plt.close(figure)


def main(study: Study, description: str, arguments: Sequence[str] | None = None) -> int:
    """Command line of a study; returns the exit status."""
    import argparse

    parser = argparse.ArgumentParser(description=description)
    parser.add_argument(
        "--out", type=Path, required=True, help="new folder, or one of this study to go on with"
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--systems", nargs="+", default=list(study.benches), metavar="SYSTEM")
    parser.add_argument("--conditions", nargs="+", default=list(study.conditions), metavar="CONDITION")
    parser.add_argument("--steps", type=int, help="environment steps of a training (default: the study's)")
    parser.add_argument("--episodes", type=int, default=20, help="evaluation episodes (default 20)")
    parser.add_argument(
        "--wall", type=int, default=0, help="evaluation episodes in wall-clock time (default 0)"
    )
    args = parser.parse_args(arguments)
    try:
        for name, value, least in (("--steps", args.steps, 501), ("--episodes", args.episodes, 1)):
            if value is not None and value < least:
                raise ExperimentError(f"{name} {value}: give at least {least}")
        run_study(
            study, args.out, args.seeds, args.systems, args.conditions, args.steps, args.episodes, args.wall,
            lambda line: print(line, flush=True),
        )  # fmt: skip
    except ExperimentError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0
