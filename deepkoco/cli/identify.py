"""`deepkoco identify`: fit parameters and delays of a system to logs of it."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepkoco.cli.input_error import InputError
from deepkoco.cli.logs import SYSTEM_HELP, add_episodes

if TYPE_CHECKING:
    from collections.abc import Callable

    from deepkoco.fit.solve.prior import Prior

DESCRIPTION = """\
Fit parameters and delays of a system to logs of it, with 95 % intervals. Name the combinations of parameters that the
logs do not identify. Writes identify.json, model.yaml (the fitted system) and pictures, each with a table of its data.

Exit status: 0 fitted, 2 bad input."""
EXAMPLE = """\
example:
  deepkoco identify logs/steps.csv --system rod_pendulum --parameters mass length viscous --delays
  deepkoco identify logs/prbs.csv --system rod_pendulum --parameters mass --hidden-delays 2
  deepkoco identify a.csv b.csv --system pendulum --parameters mass --bounds mass=0.04:0.08 --method cma"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco identify`."""
    parser.add_argument(
        "recording",
        type=Path,
        nargs="+",
        metavar="LOG",
        help="log of the unit, or a folder of logs; LOG#t=2,7.5 is a part of it [s]",
    )
    parser.add_argument(
        "--system",
        metavar="SYSTEM",
        help=f"{SYSTEM_HELP}; default: the system in the sidecar",
    )
    parser.add_argument(
        "--parameters",
        nargs="+",
        metavar="NAME",
        help='parameters to fit, such as mass or coulomb.torque ("deepkoco systems" lists them); default: all',
    )
    parser.add_argument(
        "--delays",
        nargs="*",
        metavar="CHANNEL",
        help="fit the delay of the commands too, and the delays of the named channels",
    )
    parser.add_argument(
        "--hidden-delays",
        type=int,
        nargs="?",
        const=1,
        metavar="N",
        help="fit the distribution of the commands' delays too, with N normal components (default 1)",
    )
    parser.add_argument(
        "--method", default="lm", help="lm: Levenberg-Marquardt; cma: CMA-ES (extra cma); default lm"
    )
    parser.add_argument("--population", type=int, metavar="N", help="points in a generation of cma")
    parser.add_argument("--generations", type=int, metavar="N", help="largest number of generations of cma")
    parser.add_argument(
        "--bounds", nargs="+", default=[], metavar="NAME=LOW:HIGH", help="bounds of a parameter"
    )
    parser.add_argument(
        "--prior", nargs="+", default=[], metavar="NAME=MEAN:SD", help="normal prior of a parameter"
    )
    parser.add_argument(
        "--start",
        nargs="+",
        default=[],
        metavar="NAME=VALUE",
        help="start value; for a parameter that is not fitted, its known value",
    )
    add_episodes(parser)
    parser.add_argument("--map", type=Path, metavar="MAP.yaml", help="sidecar of all logs; default: LOG.yaml")
    parser.add_argument(
        "--fill", choices=("drop", "hold"), help="rule for missing values; default: refuse them"
    )
    parser.add_argument("--window", type=float, metavar="S", help="length of a window [s]")
    parser.add_argument(
        "--zero-sd",
        type=float,
        metavar="RAD",
        help="standard deviation of the angle sensor's zero from log to log [rad]",
    )
    parser.add_argument(
        "--varies",
        nargs="+",
        default=[],
        metavar="NAME=SD",
        help="the parameter differs from log to log, with this standard deviation around a fitted common mean",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of cma's draws (default 0)")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="new folder; default: LOG_identified beside the first log"
    )
    parser.add_argument("--json", action="store_true", help="print identify.json instead of a table")


def run(args: argparse.Namespace) -> int:
    """Fit, write the folder and print the table.

    Raises:
        InputError: A log, a name, a number or the output folder cannot be used.
    """
    from deepkoco.cli.logs import read_logs, result_folder
    from deepkoco.fit.delays.hidden_delay import hidden_delays
    from deepkoco.fit.identify import fit
    from deepkoco.fit.report import as_json, terminal_report, write_identification
    from deepkoco.fit.request import FitError, command_delays
    from deepkoco.fit.solve.cma import MissingExtraError
    from deepkoco.logs.recording import LogError
    from deepkoco.output.new_folder import FolderExistsError
    from deepkoco.output.whole_file import system_error

    first = args.recording[0]
    options = {
        "bounds": {name: (low, high) for name, (low, high) in _numbers("--bounds", args.bounds, 2).items()},
        "start": {name: value for name, (value,) in _numbers("--start", args.start, 1).items()},
        "prior": _prior(args.prior),
        "method": _method(args),
        "window": args.window,
        "zero_sd": args.zero_sd,
        "varies": {name: sd for name, (sd,) in _numbers("--varies", args.varies, 1).items()},
        "seed": args.seed,
    }
    _check(args)
    try:
        out = result_folder(args.out, first, "_identified")
        system, logs = read_logs(args, args.recording, None)
        names = list(args.parameters or [p.name for p in system.parameters])
        if args.delays is not None or args.hidden_delays is not None:
            names += [n for n in command_delays(system) if n not in names]
            names += [f"{channel}.delay" for channel in args.delays or ()]
        with _Progress(args.json) as report:
            found = fit(logs, system, names, progress=report, **options)
            hidden = None
            if args.hidden_delays is not None:
                report("hidden delays", 0, 1, found.fit.cost)
                hidden = hidden_delays(found, args.hidden_delays, args.seed)
        write_identification(found, out, hidden)
    except (LogError, FitError, FolderExistsError, MissingExtraError) as error:
        raise InputError(str(error)) from error
    except OSError as error:
        raise InputError(system_error(error)) from error
    if args.json:
        sys.stdout.write(json.dumps(as_json(found, hidden), indent=2) + "\n")
    else:
        from rich.console import Console

        console = Console()
        console.print(terminal_report(found, hidden))
        console.print(f"written to {out}: identify.json, model.yaml, pictures", highlight=False)
    return 0


def _check(args: argparse.Namespace) -> None:
    if args.window is not None and not 0.05 <= args.window <= 60.0:
        raise InputError(f"--window {args.window:g}: give a length between 0.05 and 60 s")
    if args.zero_sd is not None and not 0.0 <= args.zero_sd < 10.0:
        raise InputError(f"--zero-sd {args.zero_sd:g}: give a standard deviation between 0 and 10 rad")
    if args.hidden_delays is not None and not 1 <= args.hidden_delays <= 8:
        raise InputError(f"--hidden-delays {args.hidden_delays}: give 1 to 8 components")


def _method(args: argparse.Namespace) -> Any:
    from deepkoco.fit.solve.methods import METHODS

    if args.method not in METHODS:
        raise InputError(f'--method "{args.method}" is none of {", ".join(METHODS)}')
    given = {k: getattr(args, k) for k in ("population", "generations") if getattr(args, k) is not None}
    if given and args.method != "cma":
        raise InputError(f"--{next(iter(given))} needs --method cma")
    for name, value in given.items():
        if value < (4 if name == "population" else 1):
            raise InputError(f"--{name} {value}: give at least {4 if name == 'population' else 1}")
    return METHODS[args.method](**given)


def _numbers(option: str, items: list[str], count: int) -> dict[str, tuple[float, ...]]:
    """Parse items NAME=A:B:... with ``count`` numbers each."""
    wanted = "NAME=" + ":".join(["NUMBER"] * count)
    result = {}
    for item in items:
        name, _, text = item.partition("=")
        try:
            values = tuple(float(part) for part in text.split(":"))
        except ValueError:
            values = ()
        if not name or len(values) != count:
            raise InputError(f"{option} {item}: expected {wanted}")
        result[name] = values
    return result


def _prior(items: list[str]) -> Prior | None:
    import numpy as np

    from deepkoco.fit.solve.prior import Prior

    given = _numbers("--prior", items, 2)
    for name, (_, sd) in given.items():
        if not sd > 0:
            raise InputError(f"--prior {name}: the standard deviation {sd:g} must be positive")
    if not given:
        return None
    centre, sd = np.array(list(given.values())).T
    return Prior(tuple(given), centre, np.diag(sd**2))


class _Progress:
    """Progress bar on stderr with stage, iteration and cost."""

    def __init__(self, quiet: bool) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self.bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed}/{task.total}, cost {task.fields[cost]}"),
            TimeElapsedColumn(),
            console=Console(stderr=True),
            transient=True,
            disable=quiet or not sys.stderr.isatty(),
        )
        self.tasks: dict[str, Any] = {}

    def __enter__(self) -> Callable[[str, int, int, float], None]:
        self.bar.start()
        return self.show

    def __exit__(self, *_: object) -> None:
        self.bar.stop()

    def show(self, stage: str, iteration: int, most: int, cost: float) -> None:
        if stage not in self.tasks:
            self.tasks[stage] = self.bar.add_task(stage, total=most, cost="")
        self.bar.update(self.tasks[stage], completed=iteration, cost=f"{cost:.6g}")
