"""`deepkoco design-experiment`: design the commands that distinguish given causes best."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from deepkoco.cli.input_error import InputError
from deepkoco.cli.logs import SYSTEM_HELP

if TYPE_CHECKING:
    from deepkoco.diagnose.experiment_design.design import Design

DESCRIPTION = """\
Design the command sequence after which a diagnosis distinguishes the given causes best. The sequence keeps the limits
of the actuator and those of --limits. Writes commands.csv, which `deepkoco record --commands` plays, design.yaml (the
expected result) and pictures.

Exit status: 0 designed, 2 bad input, 3 no commands distinguish these causes."""
EXAMPLE = """\
example:
  deepkoco design-experiment --system rod_pendulum --distinguish coulomb viscous --out separate
  deepkoco design-experiment --system rod_pendulum --distinguish payload gain --recording logs/monday.csv \\
      --limits torque=-1.5:1.5 omega=-6:6 --out separate
  deepkoco record --unit UNIT.yaml --commands separate/commands.csv --out logs/tuesday.csv"""
INSEPARABLE = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco design-experiment`."""
    parser.add_argument("--system", metavar="SYSTEM", help=f"{SYSTEM_HELP}; default: the system of the log")
    parser.add_argument(
        "--distinguish", nargs="+", required=True, metavar="CAUSE", help="two or more causes of the catalogue"
    )
    parser.add_argument("--model", type=Path, metavar="model.yaml", help="extended simulation to start from")
    parser.add_argument(
        "--recording",
        type=Path,
        nargs="+",
        default=[],
        metavar="LOG",
        help="existing log; fits of the causes to it give their sizes",
    )
    parser.add_argument("--map", type=Path, metavar="MAP.yaml", help="sidecar of the log; default: LOG.yaml")
    parser.add_argument("--duration", type=float, default=10.0, metavar="S", help="length [s] (default 10)")
    parser.add_argument(
        "--limits",
        nargs="+",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="narrower limits of a command, coordinate or speed, in SI units",
    )
    parser.add_argument(
        "--strength",
        type=float,
        metavar="ES",
        help="effect size of each cause (default: that in the log, else 0.5)",
    )
    parser.add_argument(
        "--rate", type=float, default=50.0, metavar="HZ", help="commands per second (default 50)"
    )
    parser.add_argument(
        "--sensor-rate", type=float, default=100.0, metavar="HZ", help="samples per second (default 100)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the search (default 0)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="new folder (default: A_or_B)")
    parser.add_argument("--json", action="store_true", help="print design.yaml as JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Design, write and print.

    Raises:
        InputError: The causes, the limits, a file or the folder cannot be used.
    """
    from deepkoco.cli.logs import read_logs
    from deepkoco.diagnose.experiment_design.design import InseparableError, design_experiment
    from deepkoco.diagnose.experiment_design.design_files import describe, write_design
    from deepkoco.diagnose.experiment_design.experiment_setup import DesignError
    from deepkoco.logs.recording import LogError
    from deepkoco.output.new_folder import FolderExistsError, check_new
    from deepkoco.output.whole_file import system_error

    if args.model is not None and args.system is not None and args.system.endswith((".yaml", ".yml")):
        raise InputError("--model and --system: both are files; give only one of them")
    if args.seed < 0 or (args.strength is not None and not 0.0 < args.strength <= 100.0):
        raise InputError("--seed must be 0 or more, --strength above 0 and at most 100")
    out = args.out or Path("_or_".join(name.replace(" ", "_") for name in args.distinguish))
    try:
        check_new(out)
        args.system, args.fill = (str(args.model) if args.model else args.system), None
        if not args.recording and args.system is None:
            raise InputError("--system: give a system, or --model or --recording")
        system, logs = read_logs(args, args.recording, None)
        found = design_experiment(
            system,
            args.distinguish,
            logs,
            seconds=args.duration,
            limits=dict(_limit(text) for text in args.limits),
            strength=args.strength,
            command_rate=args.rate,
            sensor_rate=args.sensor_rate,
            seed=args.seed,
            progress=_progress,
        )
        commands = write_design(found, out)
    except InseparableError as error:
        sys.stderr.write(f"deepkoco design-experiment: {error}\n")
        return INSEPARABLE
    except (LogError, DesignError, FolderExistsError) as error:
        raise InputError(str(error)) from error
    except OSError as error:
        raise InputError(system_error(error)) from error
    if args.json:
        sys.stdout.write(json.dumps(describe(found), indent=2, allow_nan=False) + "\n")
    else:
        _print(found, commands)
    return 0


def _limit(text: str) -> tuple[str, tuple[float, float]]:
    name, _, span = text.partition("=")
    low, _, high = span.partition(":")
    try:
        return name, (float(low), float(high))
    except ValueError:
        raise InputError(f'--limits "{text}": write NAME=LOW:HIGH, such as omega=-6:6') from None


def _progress(family: str, generation: int, best: float) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{family}, round {generation}: {best:.3g}")


def _print(design: Design, commands: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    if sys.stderr.isatty():
        sys.stderr.write("\r\033[K")
    table = Table(
        title=headline(design), title_justify="left", box=None, show_header=False, padding=(0, 2, 0, 0)
    )
    table.add_column(style="bold")
    table.add_column()
    for a, first in enumerate(design.causes):
        for b, second in enumerate(design.causes):
            if a != b:
                table.add_row(
                    f"{first} against {second}", f"expected likelihood ratio {design.ratio[a, b]:.3g}"
                )
    usual = ", ".join(
        f"{family}: all exceed the limits" if math.isnan(value) else f"{family} {value:.3g}"
        for family, value in design.typical.items()
    )
    table.add_row("usual sequences", f"{usual} (to first order)")
    if design.at_hand is not None:
        table.add_row("log at hand", f"{design.at_hand:.3g}, scaled to the same length (to first order)")
    for dose, strength in zip(design.doses, design.strength, strict=True):
        values = ", ".join(
            f"{n} = {v:.4g} {design.stage.system.parameter(n).unit}" for n, v in dose.values.items()
        )
        table.add_row(dose.cause.name, f"{values}; strength ES {strength:.2g} here")
    console = Console()
    console.print(table)
    console.print(
        f"play: deepkoco record --unit UNIT.yaml --commands {commands} --out LOG.csv", highlight=False
    )


def headline(design: Design) -> str:
    """Expected result of an experiment in one line."""
    family, chance = design.family, 100.0 * design.chance
    sequence = f"{family.capitalize()}, {design.stage.frame.seconds:g} s"
    if design.settles:
        return f"{sequence}: distinguishes them with a probability of {chance:.0f} %"
    return (
        f"{sequence}: distinguishes them only with a probability of {chance:.0f} %; "
        f"needed: about {design.seconds_needed:.3g} s of it, or wider limits, or larger causes"
    )
