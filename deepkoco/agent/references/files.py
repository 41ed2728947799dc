"""The comparison in the folder of a run: references.json, references.csv and references.png."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from deepkoco.agent.checkpoint import damaged
from deepkoco.agent.references.comparison import Comparison
from deepkoco.agent.references.picture import draw_references
from deepkoco.output.picture import as_png, house_style
from deepkoco.output.whole_file import whole_file, write_whole_text

REFERENCES = "references"


def write_comparison(folder: Path, comparison: Comparison) -> None:
    """Write the three files, each of them whole; the same comparison gives the same bytes.

    Args:
        folder: Of the run.
        comparison: What was measured.

    Raises:
        WriteError: The disk is full, or the place cannot be written.
    """
    with house_style():
        picture = draw_references(comparison)
        with whole_file(folder / f"{REFERENCES}.png") as partial:
            partial.write_bytes(as_png(picture.figure))
    text = picture.table.to_csv(index=False, lineterminator="\n", float_format="%.9g")
    write_whole_text(folder / f"{REFERENCES}.csv", text)
    content = {
        "line": comparison.line,
        "agent": comparison.agent,
        "cost": asdict(comparison.own),
        "references": [asdict(r) for r in comparison.references],
        "left_out": dict(comparison.left_out),
        "advice": list(comparison.advice),
        **({"kept": comparison.kept} if comparison.kept else {}),
        "costs": {name: np.asarray(costs).tolist() for name, costs in comparison.costs.items()},
    }
    write_whole_text(folder / f"{REFERENCES}.json", json.dumps(_without_nan(content), indent=2) + "\n")


def read_comparison(folder: Path) -> Comparison | None:
    """Read what `write_comparison` wrote.

    Args:
        folder: Of the run.

    Returns:
        The comparison; None where the run has none, as those of earlier releases.

    Raises:
        CheckpointError: The file is damaged.
    """
    path = folder / f"{REFERENCES}.json"
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        costs = {name: np.array(values, np.float64) for name, values in content["costs"].items()}
        sizes = {values.shape for values in costs.values()}
        if (
            content["agent"] not in costs
            or len(sizes) != 1
            or [len(s) for s in sizes] != [1]
            or (0,) in sizes
        ):
            raise ValueError("it does not hold one cost of each start state for every controller")
        texts = [*content["left_out"].values(), *content["advice"], content.get("kept", "")]
        if not isinstance(content["advice"], list) or not all(isinstance(text, str) for text in texts):
            raise ValueError("advice and reasons should be texts")
        kept = content.get("kept", "")
        return Comparison(content["agent"], costs, content["left_out"], tuple(content["advice"]), kept)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise damaged(path, error) from error


def _without_nan(value):
    """JSON has no word for numbers that are not finite."""
    if isinstance(value, dict):
        return {name: _without_nan(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [_without_nan(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
