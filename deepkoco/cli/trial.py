"""`deepkoco trial`: run trained policies on a unit and compare their costs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from deepkoco.cli.input_error import InputError

DESCRIPTION = """\
Run trained policies on a unit, all from the same start states, and print the cost of an episode with its 95 % bootstrap
interval. Give two runs, such as one of the simulator as given and one of the extended simulator, to compare them."""
EXAMPLE = """\
example:
  deepkoco trial runs/first runs/extended --unit unit.yaml --episodes 20 --out trials
  deepkoco trial runs/first --unit unit.yaml --actuation-delay 0.05     bridge delays that training did not have"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco trial`."""
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folders of finished training runs")
    parser.add_argument("--unit", type=Path, required=True, metavar="UNIT.yaml", help="the unit")
    parser.add_argument(
        "--episodes", type=int, default=20, metavar="N", help="episodes for each policy (default 20)"
    )
    parser.add_argument(
        "--clock", choices=("wall", "simulated"), default="wall", help="real or virtual time (default wall)"
    )
    parser.add_argument(
        "--parallel", type=int, default=8, metavar="N", help="units that run at once (default 8)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of the start states (default 0)"
    )
    parser.add_argument(
        "--actuation-delay",
        type=float,
        metavar="S",
        help="bridge delays: of observations as the numbers of the samples tell, of commands S seconds (DeepKoCo)",
    )
    parser.add_argument(
        "--increment-weight",
        type=float,
        metavar="W",
        help="with --actuation-delay: R~ of the planner; larger makes calmer commands, which bear random delays",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="new folder for trials.csv and films")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Run the trials.

    Raises:
        InputError: A run, the unit or an option cannot be used, or the new folder exists.
        UnitError: A unit failed.
    """
    from deepkoco.agent.policy import ObservationError
    from deepkoco.output.new_folder import check_new
    from deepkoco.output.whole_file import system_error
    from deepkoco.runs.hydra_command import BAD_INPUT
    from deepkoco.runs.unit_trials import (
        FEWEST_EPISODES,
        Bridging,
        as_json,
        run_trials,
        summarise,
        write_trials,
    )
    from deepkoco.unit import UnitSpecError, load_unit

    if args.out is not None and args.out.exists():
        raise InputError(f"{args.out}: exists already; choose another --out")
    if args.episodes < 1 or args.parallel < 1:
        raise InputError("--episodes and --parallel must be 1 or more")
    if args.seed < 0:
        raise InputError(f"--seed {args.seed}: give 0 or more")
    bridging = None
    if args.actuation_delay is not None:
        bridging = Bridging(args.actuation_delay, args.increment_weight)
    elif args.increment_weight is not None:
        raise InputError("--increment-weight goes with --actuation-delay; give both")
    try:
        if args.out is not None:
            check_new(args.out)
        unit = load_unit(args.unit)
        trials = run_trials(args.runs, unit, args.episodes, args.clock, args.seed, args.parallel, bridging)
        if args.out is not None:
            write_trials(args.out, trials, args.runs, unit, args.clock, args.seed, bridging)
    except (*BAD_INPUT, ObservationError, UnitSpecError) as error:
        raise InputError(str(error)) from error
    except OSError as error:
        raise InputError(system_error(error)) from error
    summary = summarise(trials)
    if args.json:
        sys.stdout.write(as_json(summary) + "\n")
        return 0
    for name, row in summary.items():
        sys.stdout.write(
            f"{name}: cost {row['mean']:.1f} [{row['low']:.1f}, {row['high']:.1f}], "
            f"median {row['median']:.1f}, "
            f"upright {100 * row['upright']:.0f} % of {row['episodes']}, late steps {row['overruns']}\n"
        )
    if 1 < args.episodes < FEWEST_EPISODES:
        sys.stdout.write(
            f"[ ]: lowest and highest cost; a 95 % interval takes {FEWEST_EPISODES} episodes or more\n"
        )
    return 0
