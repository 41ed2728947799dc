"""Learning curves of a run."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from deepkoco.output.colours import COLOURS
from deepkoco.output.picture import Picture

LOSSES = {
    "loss/linear": "linearity of the latent",
    "loss/cost_prediction": "cost, predicted over T steps",
    "loss/cost_reconstruction": "cost, at the first step",
}


def draw_learning(path: Path) -> Picture | None:
    """Cost and losses over the training episodes.

    Args:
        path: File metrics.csv of a run.

    Returns:
        The picture; None without such a file.
    """
    if not path.is_file():
        return None
    table = pd.read_csv(path)
    if table.empty or "train/cost" not in table:
        return None
    figure = Figure(figsize=(9.0, 3.6))
    left, right = figure.subplots(1, 2)
    x = table["episodes"]
    left.plot(
        x, table["train/cost"], ":", color=COLOURS["DeepKoCo"], label="training, with exploration noise"
    )
    left.plot(x, table["evaluation/cost"], "o-", markersize=3, color=COLOURS["DeepKoCo"], label="noise-free")
    left.set(xlabel="training episodes", ylabel="cost of an episode", yscale="log")
    left.legend()
    for name, label in LOSSES.items():
        if name in table:
            right.plot(x, table[name], "o-", markersize=3, label=label)
    right.set(xlabel="training episodes", ylabel="mean squared error", yscale="log")
    right.legend()
    last = table.iloc[-1]
    caption = (
        "Left, what an episode cost while the controller learned; the dotted line cannot reach the other before the "
        "exploration noise is gone. Right, the losses that were minimised; at the end an episode costs "
        f"{last['evaluation/cost']:.1f} on average over {last['evaluation/episodes']:.0f} noise-free episodes, after "
        f"{last['episodes']:.0f} training episodes and {last['seconds']:.0f} s."
    )
    return Picture("learning", "How did it learn?", caption, figure, table)
