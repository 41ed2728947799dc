"""Figures and README of the study of real delays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from experiments.plumbing.provenance import as_markdown

matplotlib.use("Agg")
import matplotlib.pyplot as plt

LEVEL = 0.05
INTERLEAVED = ("p_interleaved", "p_interleaved_independent")


def draw_distributions(figure: Any, path: Path) -> None:
    """Distribution functions of every channel: fitted half, held-out half, model."""
    first, second, model, *_ = figure
    picture, axes = plt.subplots(3, 4, figsize=(13, 8), layout="constrained")
    for axis, key in zip(axes.flat, first, strict=False):
        law = model.laws[key]
        for part, label, colour in ((first, "first half", "C0"), (second, "held-out half", "C1")):
            ordered = np.sort(part[key]) * 1e3
            axis.plot(ordered, np.arange(1, len(ordered) + 1) / len(ordered), colour, lw=1, label=label)
        low, high = np.quantile(np.concatenate([first[key], second[key]]), [0.0, 0.995])
        grid = np.linspace(low, high, 400)
        axis.plot(grid * 1e3, law.cdf(grid), "k--", lw=1, label="model")
        axis.set(title=key, xlabel="delay [ms]", xlim=(low * 1e3, high * 1e3))
    for axis in axes.flat[len(first) :]:
        axis.set_axis_off()
    axes.flat[0].legend()
    picture.savefig(path, dpi=100)
    plt.close(picture)


def draw_distances(channels: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Distance of the model to the held-out half against that of the fitted half."""
    picture, axis = plt.subplots(figsize=(5.5, 5), layout="constrained")
    for i, name in enumerate(dict.fromkeys(row["dataset"] for row in channels)):
        rows = [row for row in channels if row["dataset"] == name]
        axis.loglog(
            [r["ks_halves"] for r in rows], [r["ks_model"] for r in rows], "o", color=f"C{i}", label=name
        )
    axis.plot([0.005, 0.8], [0.005, 0.8], "k:", lw=1)
    axis.set(xlabel="first half to held-out half: KS distance", ylabel="model to held-out half: KS distance")
    axis.legend(fontsize=8)
    picture.savefig(path, dpi=110)
    plt.close(picture)


def draw_stalls(figure: Any, path: Path) -> None:
    """Excess over the median of every computation, measured and simulated."""
    *_, delays, simulated, rates = figure
    picture, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, sharey=True, layout="constrained")
    for axis, recording, title in zip(axes, (delays, simulated[0]), ("measured", "simulated"), strict=True):
        for key in (key for key in delays if "->" not in key):
            excess = np.maximum(recording[key] - np.median(recording[key]), 0) * 1e3
            axis.plot(np.arange(len(excess)) / rates[key], excess, ".", ms=3, label=key)
        axis.set(title=title, ylabel="delay above the median [ms]")
    axes[1].set_xlabel("time [s]")
    axes[0].legend(fontsize=7, ncol=4)
    picture.savefig(path, dpi=100)
    plt.close(picture)


def report(
    channels: list[dict],
    stalls: list[dict],
    ranks: list[dict],
    seed: int,
    simulated: int,
    warm_up: float,
    stretch: float,
) -> str:
    """The README of the study."""
    passed = sum(row["p_model"] >= LEVEL for row in channels)
    halves = sum(row["p_halves"] >= LEVEL for row in channels)
    both = sum(row["p_halves"] >= LEVEL and row["p_model"] >= LEVEL for row in channels)
    alone = sum(row["p_model_independent"] >= LEVEL for row in channels)
    mixed = [sum(row[name] >= LEVEL for row in channels) for name in INTERLEAVED]
    middle = float(np.median([row["ks_interleaved"] for row in channels]))
    size = float(np.median([row["effective_second"] / row["n_second"] for row in channels]))
    worse = [r for r in channels if r["p_halves"] >= LEVEL > r["p_model"]]
    names = ", ".join(f"{row['dataset']} {row['channel']}" for row in worse) or "none"
    ratio = float(np.median([row["ks_model"] / row["ks_halves"] for row in channels]))
    summary = "\n".join(
        f"| {name} | {len(rows)} | {sum(r['p_halves'] >= LEVEL for r in rows)} "
        f"| {sum(r['p_model'] >= LEVEL for r in rows)} | {np.median([r['ks_halves'] for r in rows]):.3f} "
        f"| {np.median([r['ks_model'] for r in rows]):.3f} | {np.median([r['ks_fit'] for r in rows]):.3f} |"
        for name in dict.fromkeys(row["dataset"] for row in channels)
        if (rows := [row for row in channels if row["dataset"] == name])
    )
    stall_table = "\n".join(
        f"| {r['dataset']} | {r['per_minute']} | {r['per_minute_simulated']} | {r['nodes_hit']} of {r['nodes']} "
        f"| {r['nodes_hit_simulated']} | {r['duration_ms']} | {r['duration_ms_simulated']} "
        f"| {r['first_half']} / {r['second_half']} | {r['second_half_predicted']} |"
        for r in stalls
    )
    strong = sorted(ranks, key=lambda row: -abs(row["measured"]))[:12]
    rank_table = "\n".join(
        f"| {r['dataset']} | {r['channels'].replace('|', 'and')} | {r['measured']} | {r['simulated']} "
        f"| {r['first_half']} / {r['second_half']} |"
        for r in strong
    )
    return f"""# Real delays: does a fitted model tell what comes next?

```
python -m experiments.studies.graph.real_delays ../shared/data/rex_real_delays --seed {seed}
```

{as_markdown()}

Delays measured on three machines (published with REX, Apache-2.0). A model is fitted to the first half of
every channel (`fit_delays`: mixture by BIC, correlation in time, rank correlations, stalls) and tested on the second.
The first {warm_up:g} s are left out as warm-up.

**Test.** Kolmogorov-Smirnov between the model's distribution function and the held-out half. Neighbours in time are
correlated, so the significance is that of two samples of the *effective* sizes n / tau (tau: integrated
autocorrelation time of the normal scores, Geyer's initial positive sequence). `p_anderson_darling` is the
Anderson-Darling test between draws of the model and the held-out half, both thinned to one in tau samples
(p is cut off at 0.001 and 0.25). The median effective size is {size:.3f} of n: drift within a half counts as
correlation, too, and makes the test mild. Were the samples taken as independent, which they are not, {alone} of the
{len(channels)} models would pass. The ceiling is the same test between the two halves of the raw data: where the
machine itself changes between them, no model of the first can pass.

**Result** (level {LEVEL:g}): {passed} of {len(channels)} channels pass; of the raw halves {halves} do.
{both} pass both. Passed by the raw halves but not by the model: {names}. Median of the ratio of the
two distances: {ratio:.2f}; 1 means that the model is as far from the held-out half as the data it was fitted to.

| recording | channels | raw halves agree | model passes | KS halves | KS model | KS to its own half |
|---|---|---|---|---|---|---|
{summary}

(median distances). Where the raw halves differ, it is drift: the machine did not repeat itself, and the model, which
is stationary, does not either. That is a negative result for those channels: a model fitted to half a
recording does not tell the other half's distribution; the distance says by how much.

**Without the drift.** The same mixtures fitted to every other {stretch:g} s of a channel and tested on the stretches
between (`ks_interleaved`): {mixed[0]} of {len(channels)} pass, {mixed[1]} even with all samples taken as independent;
median distance {middle:.3f}. So it is the time between the halves, not the family of laws, that a model misses.

![distances](distances.png)
![distributions, 20 Hz pendulum](distributions.png)

## Stalls

Fitted to the whole recording and simulated on the measured graph ({simulated} recordings of the
same length); stalls are detected in the simulated delays as in the measured ones. Prediction: from the stalls of
the first half alone.

| recording | per minute | simulated | nodes hit | simulated | length [ms] | simulated | halves | predicted |
|---|---|---|---|---|---|---|---|---|
{stall_table}

One stall in a half, or none, cannot give a rate: there the prediction is what little it is. The arm's stalls come
every 50 s, nearly periodic, which the refractory time takes up.

![stalls of the arm](stalls.png)

## Rank correlation of channels of one publisher

Fitted to the whole recording and simulated on the measured graph. The twelve strongest of
{len(ranks)} (`rank_correlations.csv`):

| recording | channels | measured | simulated | first / second half |
|---|---|---|---|---|
{rank_table}
"""
