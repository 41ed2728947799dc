"""What to do with a diagnosis: the commands that check its model and train in it."""

from __future__ import annotations

from typing import NamedTuple

from deepkoco.diagnose.diagnosis import Diagnosis
from deepkoco.systems import ExtendedSystem

TRAIN = "deepkoco train"
"""The command that trains a controller."""
# System -> what chooses its task in the command above. The rod's first task has an integrator of its own.
TASKS = {
    "rod_pendulum": "task=pendulum task.id=deepkoco/RodPendulumDelay-v0",
    "pendulum": "task=disk_pendulum",
    "torque_pendulum": "task=torque_pendulum",
    "two_link_arm": "task=manipulator",
}


class Step(NamedTuple):
    """One thing to do.

    Attributes:
        text: What and why.
        command: To be typed; empty where there is none.
    """

    text: str
    command: str


def next_steps(diagnosis: Diagnosis, folder: str) -> list[Step]:
    """What to do with the model that a diagnosis has written; nothing where it has written none.

    Args:
        diagnosis: The diagnosis.
        folder: Of its report, as the commands shall name it.
    """
    if diagnosis.verdict == "insufficient":
        return []
    model, runs = f"{folder}/model.yaml", "runs/extended"
    base = diagnosis.model.base if isinstance(diagnosis.model, ExtendedSystem) else diagnosis.model
    steps = [
        Step(
            "Record another log and diagnose it with this model. If the model is right, nothing is missing any more.",
            f"deepkoco diagnose OTHER_LOG.csv --system {model} --out {folder}_check",
        )
    ]
    if base.name in TASKS:
        command = f"{TRAIN} {TASKS[base.name]} +task.kwargs.model={model} run={runs}"
        steps += [
            Step("Train a controller in the extended simulation.", command),
            Step("See what the controller has learned.", f"deepkoco show {runs}"),
        ]
    else:
        code = f'from deepkoco.systems import load_model\n\nsystem = load_model("{model}")'
        steps.append(Step("Use the extended simulation in a program.", code))
    return steps
