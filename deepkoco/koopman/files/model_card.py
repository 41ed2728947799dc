"""README.md of a model's folder: what a reader of the folder or of its page on a hub should know."""

from __future__ import annotations

from typing import Any

HEADER = """\
---
library_name: deepkoco
tags:
- koopman
- model-predictive-control
- reinforcement-learning
---
"""


def model_card(config: dict[str, Any]) -> str:
    """Write the card from what config.json holds.

    Args:
        config: Entries of config.json.

    Returns:
        Markdown with the front matter of a model hub.
    """
    task, training = config.get("task") or {}, config.get("training") or {}
    name = task.get("name") or task.get("id") or "an unnamed task"
    lines = [
        HEADER,
        f"# Koopman controller for {name}",
        "",
        "A latent model with linear dynamics and a square cost, and the settings of the model-predictive",
        "controller that plans on it: one quadratic program per step.",
        "",
        "```python",
        "import deepkoco",
        "",
        'model = deepkoco.load("PATH_OR_ORG/NAME")',
        "model.reset()",
        "action = model.act(observation)  # once per control step",
        "```",
        "",
        "| entry | value |",
        "|---|---|",
    ]
    entries = {
        "kind of model": config.get("kind"),
        "time step [s]": config.get("time_step"),
        "task": task.get("name"),
        "environment id": task.get("id"),
        "environment arguments": task.get("kwargs") or None,
        "observation": task.get("observation"),
        "distractors": task.get("distractors"),
        "unit of the actions": task.get("action_units"),
        "smallest action": config.get("action_low"),
        "largest action": config.get("action_high"),
        "training seed": training.get("seed"),
        "training episodes": training.get("episodes"),
        "after training": training.get("comparison"),
        "written by": training.get("package"),
    }
    lines += [f"| {key} | {_cell(value)} |" for key, value in entries.items() if value is not None]
    lines += ["", "The folder holds numbers and names only; loading it runs no code from it.", ""]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    return " ".join(str(value).split()).replace("|", "\\|")
