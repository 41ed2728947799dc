"""`deepkoco train`: train an agent by `deepkoco.runs`, with settings of Hydra."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from deepkoco.cli.input_error import InputError

DESCRIPTION = """\
Train an agent in a task and write a folder: settings, metrics, checkpoint and, at the end, the model. Settings
NAME=VALUE select task and agent. Every setting has a default; "deepkoco train --cfg job" prints all of them."""
EXAMPLE = """\
example:
  deepkoco train task=pendulum seed=0 distractors=none run=runs/first
  deepkoco train --system my_robot.py:CartPole --task my_task.py:Swing run=runs/swing
                                   a robot and a task of your own; without --task all positions go to 0
  deepkoco train --system report/model.yaml --task my_task.py:Swing run=runs/extended
                                   the same in a simulator that diagnose has extended
  deepkoco train task=gymnasium task.id=my_robot:Cart-v0 agent.model.time_step=0.02 run=runs/cart
                                   the module my_robot, of the current folder or installed, registers Cart-v0
  deepkoco train task.id=deepkoco/RodPendulumDelay-v0 +task.kwargs.model=report/model.yaml run=runs/extended
                                   the swing-up in a simulator that diagnose has extended
  deepkoco train resume=runs/first                       go on after a kill, with the stored settings
  deepkoco train resume=runs/first agent.total_episodes=600    prolong it, finished or not
  deepkoco train --config-dir my_configs task=cart       task/cart.yaml in your own folder

task names: the files of configs/task; agents: deepkoco, sac, sac_shared, deepmdp, dbc. "deepkoco sweep" trains many."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments in the help; `run_settings` gets the arguments unparsed."""
    parser.add_argument(
        "--system",
        help="robot: a name, my_robot.py:CLASS, package.module:CLASS, arm.xml, arm.urdf or model.yaml",
    )
    parser.add_argument("--task", help="task on it: my_task.py:CLASS, package.module:CLASS or a name")
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

    return exit_status("train", train, with_robot(arguments))


def with_robot(arguments: Sequence[str]) -> list[str]:
    """The arguments with ``--system`` and ``--task`` as settings of Hydra.

    The step of the agent's model follows from the task's rate, unless a setting gives it.

    Args:
        arguments: Of the command.

    Raises:
        InputError: A value is missing, or there is no such system or task.
    """
    rest, given = [], {}
    words = iter(arguments)
    for word in words:
        option, sign, value = word.partition("=")
        if option not in ("--system", "--task"):
            rest.append(word)
            continue
        value = value if sign else next(words, "")
        if not value or value.startswith("-"):
            raise InputError(f"{option}: give a value, such as {option} my_robot.py:CLASS")
        given[option[2:]] = value
    if not given:
        return rest
    if "system" not in given:
        raise InputError("--task: give --system too: the robot of the task")
    if any(word.startswith(("task=", "task.id=")) for word in rest):
        raise InputError("--system and the setting task: give only one of them")
    from deepkoco.envs.settings import EnvironmentSettings
    from deepkoco.systems import ModelFileError, UnknownSystemError

    try:
        settings = EnvironmentSettings(**given, world_rate=None)
        task, name = settings.find_task(), settings.make_system().name
    except (ModelFileError, UnknownSystemError) as error:
        raise InputError(f"--system: {error}") from error
    except ValueError as error:
        raise InputError(str(error)) from error
    added = ["task=robot", f"task.name={_quoted(name)}"]
    added += [f"+task.kwargs.{key}={_quoted(value)}" for key, value in given.items()]
    own_agent = any(word.startswith("agent=") and word != "agent=deepkoco" for word in rest)
    if not own_agent and not any("agent.model.time_step=" in word for word in rest):
        added.append(f"agent.model.time_step={1.0 / task.control_rate!r}")
    return [*added, *rest]


def _quoted(text: str) -> str:
    """A text as Hydra's grammar quotes it."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
