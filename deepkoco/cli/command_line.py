"""`deepkoco`: parse the command line and run one subcommand."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from types import ModuleType

from deepkoco import __version__
from deepkoco.cli.input_error import InputError
from deepkoco.cli.parser import CommandParser
from deepkoco.output.whole_file import system_error
from deepkoco.suggestion import did_you_mean
from deepkoco.unit.messages import UnitError

DESCRIPTION = "Record a robot, fit and diagnose its simulation, extend it, and train a controller in it."
EXAMPLE = """\
example, from a unit to a diagnosis and a controller:
  deepkoco record --unit configs/units/rod_pendulum_coulomb.yaml --seconds 30 --out logs/coulomb.csv
  deepkoco inspect logs/coulomb.csv
  deepkoco diagnose logs/coulomb.csv --system rod_pendulum --out report
  deepkoco train task.id=deepkoco/RodPendulumDelay-v0 +task.kwargs.model=report/model.yaml run=runs/extended

"deepkoco COMMAND --help" describes each command."""
# subcommand: (module with add_arguments, DESCRIPTION, EXAMPLE and run, or run_settings where the arguments are for
# Hydra; one line for the list)
COMMANDS = {
    "record": ("deepkoco.cli.record", "drive a unit with an excitation and write a measured log"),
    "inspect": (
        "deepkoco.cli.inspect",
        "show the contents of a log (CSV, Parquet, MCAP, ROS bags) and propose a mapping of its columns",
    ),
    "identify": (
        "deepkoco.cli.identify",
        "fit parameters and delays of a system to logs, with intervals",
    ),
    "diagnose": (
        "deepkoco.cli.diagnose",
        "name the effects that the simulation of a logged robot lacks, and extend it",
    ),
    "design-experiment": (
        "deepkoco.cli.design_experiment",
        "design the commands that distinguish causes best; record plays them",
    ),
    "train": ("deepkoco.cli.train", "train an agent in a task, and write its model"),
    "evaluate": ("deepkoco.cli.evaluate", "run a trained agent in noise-free episodes"),
    "sweep": ("deepkoco.cli.sweep", "train for all combinations of seeds and settings"),
    "aggregate": ("deepkoco.cli.aggregate", "learning curves and final costs of many runs"),
    "trial": ("deepkoco.cli.trial", "run trained policies on a unit and compare their costs"),
    "serve": ("deepkoco.cli.serve", "run the nodes at a robot for another machine that leads"),
    "lead": ("deepkoco.cli.lead", "run a graph with a robot on another machine"),
    "merge": ("deepkoco.cli.merge", "put the recordings of two machines together"),
    "show": (
        "deepkoco.cli.show",
        "show the contents of a recording of a graph, or analyse a trained model",
    ),
    "export": ("deepkoco.cli.export", "write a recording of a graph as CSV or Parquet"),
    "export-model": (
        "deepkoco.cli.export_model",
        "write a trained or imported model as ONNX, torch.export or plain arrays",
    ),
    "systems": ("deepkoco.cli.systems", "list the systems with parameters, units and bounds"),
}


def build_parser(command: str | None = None) -> CommandParser:
    """Parser of the command line.

    Args:
        command: Subcommand to declare completely. The others are only listed, so that their modules are not imported.
    """
    parser = CommandParser(
        prog="deepkoco",
        description=DESCRIPTION,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"deepkoco {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, title="commands")
    for name, (module_name, summary) in COMMANDS.items():
        if name != command:
            subparsers.add_parser(name, help=summary, add_help=False)
            continue
        module = import_module(module_name)
        subparser = subparsers.add_parser(
            name,
            help=summary,
            description=getattr(module, "DESCRIPTION", summary),
            epilog=getattr(module, "EXAMPLE", None),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(subparser)
        subparser.set_defaults(run=getattr(module, "run", None) or _without_settings(module))
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a subcommand.

    Args:
        arguments: Command line without the name of the program; None takes that of the process.

    Returns:
        Exit status: 0 done, 1 the unit failed, 2 bad input or a place that cannot be written,
            130 interrupted. Some subcommands have others too.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    command = next((a for a in arguments if not a.startswith("-")), None)
    parser = build_parser(command)
    if command is not None and command not in COMMANDS:
        suggestion = did_you_mean(command, COMMANDS) or "; the commands are listed above"
        parser.print_help(sys.stderr)
        parser.exit(2, f'\ndeepkoco: there is no command "{command}"{suggestion}\n')
    try:
        settings = _settings_of(command, arguments)
        if settings is not None:
            return import_module(COMMANDS[str(command)][0]).run_settings(settings)
        args = parser.parse_args(arguments)
        status = args.run(args)
        sys.stdout.flush()
        return status
    except InputError as error:
        status, text = 2, str(error)
    except UnitError as error:
        status, text = 1, str(error)
    except OSError as error:
        if isinstance(error, BrokenPipeError):  # nobody reads what is printed any more, as behind "| head"
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        status, text = 2, system_error(error)
    except KeyboardInterrupt as interrupt:
        status, text = 130, "; ".join(("interrupted", *map(str, interrupt.args)))
    sys.stderr.write(f"deepkoco {command}: {' '.join(text.split())}\n")
    return status


def _without_settings(module: ModuleType) -> Callable[[argparse.Namespace], int]:
    return lambda args: module.run_settings([])


def _settings_of(command: str | None, arguments: Sequence[str]) -> list[str] | None:
    """Arguments after a command whose arguments are for Hydra; None for other commands and for help."""
    if command is None or arguments[0] != command or {"-h", "--help"} & set(arguments):
        return None
    return list(arguments[1:]) if hasattr(import_module(COMMANDS[command][0]), "run_settings") else None


if __name__ == "__main__":
    raise SystemExit(main())
