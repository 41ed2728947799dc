"""`deepkoco`: parse the command line and run one subcommand."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

from deepkoco import __version__
from deepkoco.cli.input_error import InputError
from deepkoco.unit.messages import UnitError

DESCRIPTION = "Record a robot, fit and diagnose its simulation, and show recordings and models."
EXAMPLE = """\
example, from a unit to a diagnosis:
  deepkoco record --unit configs/units/rod_pendulum_coulomb.yaml --seconds 30 --out logs/coulomb.csv
  deepkoco inspect logs/coulomb.csv
  deepkoco diagnose logs/coulomb.csv --system rod_pendulum --out logs/coulomb_report

"deepkoco COMMAND --help" describes each command."""
# subcommand: (module with add_arguments, run, DESCRIPTION and EXAMPLE, one line for the list)
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


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """Parser of the command line.

    Args:
        command: Subcommand to declare completely. The others are only listed, so that their modules are not imported.
    """
    parser = argparse.ArgumentParser(
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
        subparser.set_defaults(run=module.run)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a subcommand.

    Args:
        arguments: Command line without the name of the program; None takes that of the process.

    Returns:
        Exit status: 0 done, 1 the unit failed, 2 bad input, 130 interrupted. Some subcommands have others too.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    command = next((a for a in arguments if not a.startswith("-")), None)
    args = build_parser(command).parse_args(arguments)
    try:
        return args.run(args)
    except InputError as error:
        status, text = 2, str(error)
    except UnitError as error:
        status, text = 1, str(error)
    except KeyboardInterrupt as interrupt:
        status, text = 130, "; ".join(("interrupted", *map(str, interrupt.args)))
    sys.stderr.write(f"deepkoco {args.command}: {' '.join(text.split())}\n")
    return status


if __name__ == "__main__":
    raise SystemExit(main())
