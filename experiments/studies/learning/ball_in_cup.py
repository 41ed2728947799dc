"""Why ball_in_cup-catch shows no difference to doing nothing: what kinds of exploration lift the ball, and how high.

    python -m experiments.studies.learning.ball_in_cup --out ball_in_cup --episodes 60 --seed 0 --run RUN

The folder then holds:

    episodes.csv      one row per kind and episode: greatest height of the ball, and whether it came into the cup
    ball_in_cup.png   the heights, and the share of episodes that find the cup
    PROVENANCE.md     commit, versions and processor
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import binomtest

from deepkoco.agent.policy import load_policy
from deepkoco.envs.dm_control import make_dm_control
from deepkoco.output.colours import COLOURS
from deepkoco.output.new_folder import new_folder
from deepkoco.output.picture import as_png, house_style
from experiments.plumbing.provenance import as_markdown

STEPS = 250
PERIOD = 0.08  # s between two actions, as in the study of untuned tasks
HEIGHT_OF_BALL, HEIGHT_OF_CUP = (
    3,
    1,
)  # entries of the observation [m], each from where the model file puts the body
TARGET = 0.35  # m; ball above cup in these entries where the ball is at the cup's target
Act = Callable[[np.ndarray], np.ndarray]
Explorer = Callable[[np.random.Generator], Act]


def still(rng: np.random.Generator) -> Act:
    """Zero action."""
    return lambda observation: np.zeros(2)


def noise_on_increments(correlation: float) -> Explorer:
    """DeepKoCo's exploration: Ornstein-Uhlenbeck noise on the increments of the action, clipped at its limits."""

    def start(rng: np.random.Generator) -> Act:
        action, noise = np.zeros(2), np.zeros(2)

        def act(observation: np.ndarray) -> np.ndarray:
            nonlocal action, noise
            sent = action
            noise = correlation * noise + 0.5 * math.sqrt(0.85) * rng.standard_normal(2)
            action = np.clip(action + noise, -1.0, 1.0)
            return sent

        return act

    return start


def uniform(rng: np.random.Generator) -> Act:
    """Any action, anew at every step: the first steps of SAC."""
    return lambda observation: rng.uniform(-1.0, 1.0, 2)


def tone(rng: np.random.Generator) -> Act:
    """One sine of full amplitude for each action, of a frequency and a phase drawn for the episode."""
    frequency, phase = rng.uniform(0.5, 3.0, 2), rng.uniform(0.0, 2.0 * math.pi, 2)
    step = -1

    def act(observation: np.ndarray) -> np.ndarray:
        nonlocal step
        step += 1
        return np.sin(2.0 * math.pi * frequency * step * PERIOD + phase)

    return act


EXPLORERS: dict[str, Explorer] = {
    "zero action": still,
    "noise on increments (default)": noise_on_increments(0.85),
    "white noise on increments": noise_on_increments(0.0),
    "uniform actions": uniform,
    "a tone an episode, 0.5 to 3 Hz": tone,
}


def trained(run: Path) -> Explorer:
    """The controller of a run."""
    policy = load_policy(run)

    def start(rng: np.random.Generator) -> Act:
        policy.reset()
        return policy.act

    return start


def play(name: str, explorer: Explorer, episodes: int, seed: int) -> pd.DataFrame:
    """Episodes of one kind from the same start states for all kinds.

    Args:
        name: Of the kind.
        explorer: Begins an episode.
        episodes: How many.
        seed: Of start states and draws.

    Returns:
        One row per episode: kind, episode, whether it began in the cup, greatest height [m] of the ball above the cup's
        target, and whether the ball came into the cup.
    """
    env = make_dm_control("ball_in_cup", "catch", action_repeat=4)
    rows = []
    for episode in range(episodes):
        observation, _ = env.reset(seed=int(np.random.SeedSequence((seed, episode)).generate_state(1)[0]))
        act = explorer(np.random.default_rng((seed, episode)))
        heights, rewards = [], []
        for _ in range(STEPS):
            observation, reward, *_ = env.step(act(observation).astype(np.float32))
            heights.append(observation[HEIGHT_OF_BALL] - observation[HEIGHT_OF_CUP] - TARGET)
            rewards.append(1.0 + float(reward))
        row = {"kind": name, "episode": episode, "began_in_cup": rewards[0] > 0.0}
        rows.append({**row, "height_m": max(heights), "caught": max(rewards) > 0.0})
    env.close()
    return pd.DataFrame(rows)


def draw(table: pd.DataFrame) -> Figure:
    """Heights of the ball, and shares of episodes that find the cup with their 95 % intervals.

    Args:
        table: Rows of `play`, without episodes that begin in the cup.
    """
    kinds = list(dict.fromkeys(table["kind"]))
    with house_style():
        figure = Figure(figsize=(9.0, 0.45 * len(kinds) + 1.4))
        heights, shares = figure.subplots(1, 2, sharey=True)
        for place, kind in enumerate(kinds):
            own = table.query("kind == @kind")
            colour = COLOURS["DeepKoCo" if kind == "trained controller" else "muted"]
            spread = place + np.linspace(-0.25, 0.25, len(own))
            heights.plot(own["height_m"], spread, ".", color=colour)
            found = binomtest(int(np.count_nonzero(own["caught"])), len(own)).proportion_ci(method="wilson")
            shares.plot([100 * found.low, 100 * found.high], [place, place], color=colour)
            shares.plot(100 * own["caught"].mean(), place, "o", color=colour)
        heights.axvline(0.0, color=COLOURS["reference"], label="target in the cup")
        heights.set_yticks(range(len(kinds)), kinds)
        heights.set(xlabel="greatest height of the ball above the target in an episode [m]")
        heights.invert_yaxis()
        heights.legend()
        shares.set(xlabel="episodes that find the cup [%]", xlim=(0, 100))
    return figure


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="What lifts the ball of ball_in_cup-catch, and how high.")
    parser.add_argument("--out", type=Path, required=True, help="new folder")
    parser.add_argument("--episodes", type=int, default=60, help="of each kind")
    parser.add_argument("--seed", type=int, default=0, help="of start states and draws")
    parser.add_argument("--run", type=Path, help="finished run on the task, played beside the others")
    args = parser.parse_args(arguments)
    explorers = dict(EXPLORERS)
    if args.run is not None:
        explorers["trained controller"] = trained(args.run)
    parts = [play(name, explorer, args.episodes, args.seed) for name, explorer in explorers.items()]
    table = pd.concat(parts, ignore_index=True)
    chosen = table.query("not began_in_cup")
    with new_folder(args.out) as partial:
        table.to_csv(partial / "episodes.csv", index=False, float_format="%.4g")
        (partial / "ball_in_cup.png").write_bytes(as_png(draw(chosen)))
        (partial / "PROVENANCE.md").write_text(as_markdown() + "\n", encoding="utf-8")
    print(chosen.pivot_table(["height_m", "caught"], "kind", sort=False).to_string(float_format="%.3f"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
