"""Next steps after a diagnosis: commands that check its model and train a controller in it."""

from __future__ import annotations

from typing import NamedTuple

from deepkoco.diagnose.diagnosis import Diagnosis
from deepkoco.systems import ExtendedSystem

TRAIN = "deepkoco train"
"""The command that trains a controller."""
# System -> arguments that choose its task in the command above. The first task of the rod uses its own integrator.
TASKS = {
    "rod_pendulum": "task=pendulum task.id=deepkoco/RodPendulumDelay-v0",
    "pendulum": "task=disk_pendulum",
    "torque_pendulum": "task=torque_pendulum",
    "two_link_arm": "task=manipulator",
}


class Step(NamedTuple):
    """One step.

    Attributes:
        text: What to do and why.
        command: Command or code; empty where there is none.
    """

    text: str
    command: str


def next_steps(diagnosis: Diagnosis, folder: str) -> list[Step]:
    """Return the steps that use the model of a diagnosis; none if it wrote no model.

    Args:
        diagnosis: The diagnosis.
        folder: Folder of its report, as the commands name it.
    """
    if diagnosis.verdict == "insufficient":
        return []
    model, runs = f"{folder}/model.yaml", "runs/extended"
    base = diagnosis.model.base if isinstance(diagnosis.model, ExtendedSystem) else diagnosis.model
    steps = [
        Step(
            "Record another log and diagnose it with this model. If the model is right, the verdict is `nothing`.",
            f"deepkoco diagnose OTHER_LOG.csv --system {model} --out {folder}_check",
        )
    ]
    if base.name in TASKS:
        text = "Train a controller in the extended simulation."
        command = f"{TRAIN} {TASKS[base.name]} +task.kwargs.model={model} run={runs}"
    else:
        text = "Train a controller in the extended simulation. Without --task my_task.py:CLASS all positions go to 0."
        command = f"{TRAIN} --system {model} run={runs}"
    steps += [Step(text, command), Step("Show what the controller has learned.", f"deepkoco show {runs}")]
    return steps
