"""`deepkoco systems`: list the systems with their channels, parameters and effects."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from deepkoco.cli.input_error import InputError
from deepkoco.cli.logs import SYSTEM_HELP

if TYPE_CHECKING:
    from deepkoco.systems import System

DESCRIPTION = "List the systems of the package and those registered: channels, parameters, units and bounds."
EXAMPLE = """\
example:
  deepkoco systems
  deepkoco systems rod_pendulum --effects
  deepkoco systems my_robot.py:CartPole"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco systems`."""
    parser.add_argument("system", nargs="?", help=f"show only this {SYSTEM_HELP}")
    parser.add_argument("--effects", action="store_true", help="list the parameters of the effects too")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")


def run(args: argparse.Namespace) -> int:
    """Print the systems.

    Raises:
        InputError: There is no such system.
    """
    from deepkoco.systems import ExtendedSystem, ModelFileError, UnknownSystemError, load_system, system_names
    from deepkoco.systems.effects import effects_of

    try:
        systems = [load_system(name) for name in ([args.system] if args.system else system_names())]
    except (ModelFileError, UnknownSystemError) as error:
        raise InputError(str(error)) from error
    if args.effects:
        bases = [s.base if isinstance(s, ExtendedSystem) else s for s in systems]
        systems = [ExtendedSystem(s, tuple(effects_of(s))) for s in bases]
    described = [_describe(system) for system in systems]
    if args.json:
        sys.stdout.write(json.dumps(described, indent=2) + "\n")
        return 0
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    for system in described:
        console.print(f"[bold]{system['name']}[/bold]")
        for channel in system["channels"]:
            limits = f", {channel['low']:g} to {channel['high']:g}" if channel["kind"] == "command" else ""
            signal = f"{channel['name']} ({channel['unit']}{limits})"
            text = f"  {channel['kind']:<12}{signal}"
            text += f": {channel['description']}" if channel["description"] else ""
            console.print(text, highlight=False, markup=False)
        table = Table()
        # Users copy names and values, so only the meaning is folded.
        table.add_column("parameter", no_wrap=True)
        table.add_column("value, bounds", no_wrap=True)
        table.add_column("meaning", overflow="fold")
        for p in system["parameters"]:
            value = f"{p['value']:g} [{p['low']:g}, {p['high']:g}] {p['unit']}"
            # A unit in brackets is no markup.
            table.add_row(*(Text(cell) for cell in (p["name"], value, p["description"])))
        console.print(table)
    return 0


def _describe(system: System) -> dict[str, Any]:
    limited = {"low", "high"}
    return {
        "name": system.name,
        "channels": [
            {
                key: getattr(channel, key)
                for key in ("name", "kind", "unit", "low", "high", "description")
                if key not in limited or channel.kind == "command"
            }
            for channel in (*system.commands, *system.measurements)
        ],
        "parameters": [
            {key: getattr(p, key) for key in ("name", "value", "unit", "low", "high", "description")}
            for p in system.parameters
        ],
    }
