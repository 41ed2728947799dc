"""`deepkoco train`: train an agent by `deepkoco.runs`, with settings of Hydra."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

DESCRIPTION = """\
Train an agent in a task and write a folder: settings, metrics, checkpoint and, at the end, the model. Settings
NAME=VALUE select task and agent. Every setting has a default; "deepkoco train --cfg job" prints all of them."""
EXAMPLE = """\
example:
  deepkoco train task=pendulum seed=0 distractors=none run=runs/first
  deepkoco train task=gymnasium task.id=my_robot:Cart-v0 agent.model.time_step=0.02 run=runs/cart
                                   the module my_robot, of the current folder or installed, registers Cart-v0
  deepkoco train task.id=deepkoco/RodPendulumDelay-v0 +task.kwargs.model=report/model.yaml run=runs/extended
                                   the swing-up in a simulator that diagnose has extended
  deepkoco train resume=runs/first                       go on after a kill, with the stored settings
  deepkoco train --config-dir my_configs task=cart       task/cart.yaml in your own folder

task names: the files of configs/task; agents: deepkoco, sac, sac_shared, deepmdp, dbc. "deepkoco sweep" trains many."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments in the help; `run_settings` gets the arguments unparsed."""
    parser.add_argument("settings", nargs="*", metavar="NAME=VALUE", help="settings, such as seed=1")
    parser.add_argument("--cfg", metavar="job", help="print all settings instead of training")
    parser.add_argument("--config-dir", metavar="DIR", help="folder with further files of settings")


def run_settings(arguments: Sequence[str]) -> int:
    """Train.

    Args:
        arguments: Settings, and options of Hydra.

    Returns:
        Exit status.
    """
    from deepkoco.runs.hydra_command import exit_status
    from deepkoco.runs.train import train

    return exit_status("train", train, arguments)
