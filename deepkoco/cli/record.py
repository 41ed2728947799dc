"""`deepkoco record`: drive a unit with an excitation and write a log."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from deepkoco.cli.input_error import InputError

if TYPE_CHECKING:
    from deepkoco.logs.recording import Recording

DESCRIPTION = """\
Drive a unit, which stands for a real robot, with an excitation. Write commands and measurements as LOG.csv with the
sidecar LOG.yaml. The unit runs in its own process, in wall-clock time. Only its commands and sensor messages are
accessible; time stamps are the times at which they are sent and received."""
EXAMPLE = """\
example:
  deepkoco record --system rod_pendulum --unit configs/units/rod_pendulum_coulomb.yaml \\
      --seconds 30 --excitation chirp --out logs/coulomb.csv"""
EXCITATIONS = ("chirp", "steps", "prbs", "bang-bang", "policy")
BETWEEN_UPDATES = 0.5  # time between updates of the progress bar [s]; drawing delays the next message


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco record`."""
    parser.add_argument("--system", help="system of the unit (default: the system in UNIT.yaml)")
    parser.add_argument(
        "--unit",
        required=True,
        type=Path,
        metavar="UNIT.yaml",
        help="description of the unit with its true parameters and effects",
    )
    parser.add_argument(
        "--seconds", type=float, help="length of the log [s] (default: 30, or that of --commands)"
    )
    parser.add_argument("--excitation", choices=EXCITATIONS, help="excitation of the unit (default: chirp)")
    parser.add_argument(
        "--commands",
        type=Path,
        metavar="FILE.csv",
        help="play these commands instead, for example those of `deepkoco design-experiment`",
    )
    parser.add_argument("--policy", type=Path, metavar="DIR", help="folder of a trained policy")
    parser.add_argument("--amplitude", type=float, help="largest command (default: the system's limit)")
    parser.add_argument("--rate", type=float, metavar="HZ", help="commands per second (default: 50)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the excitation (default: 0)")
    parser.add_argument(
        "--simulated",
        action="store_true",
        help="virtual instead of wall-clock time: exact times, and no waiting",
    )
    parser.add_argument("--out", required=True, type=Path, metavar="LOG.csv", help="log to write")


def run(args: argparse.Namespace) -> int:
    """Record and write the log.

    Raises:
        InputError: An argument or a file is wrong.
        UnitError: The unit died during the recording.
    """
    if args.out.name in ("", ".."):
        raise InputError(f'--out "{args.out}": is not a file name; give a name that ends in .csv')
    out: Path = args.out if args.out.suffix else args.out.with_suffix(".csv")
    if out.suffix != ".csv":
        raise InputError(f"{out}: logs are written as CSV; give a name that ends in .csv")
    for target in (out, out.with_suffix(".yaml")):
        if target.exists():
            raise InputError(f"{target}: exists; choose another name or move it away")
    if args.commands is not None and (args.excitation or args.policy or args.amplitude):
        raise InputError(
            "--commands: the file already gives the commands; leave --excitation, --policy and --amplitude out"
        )
    if (args.policy is None) != (args.excitation != "policy"):
        raise InputError("--policy: needs --excitation policy and the other way round; give both or neither")
    if args.policy is not None and args.amplitude is not None:
        raise InputError("--amplitude: a policy chooses its own commands; leave it out")

    from deepkoco.excitation.played import CommandFileError, load_commands
    from deepkoco.excitation.policy import load_policy_excitation
    from deepkoco.excitation.record import RecordError, record
    from deepkoco.excitation.signal import ExcitationError
    from deepkoco.logs.recording import LogError, write_log
    from deepkoco.output.new_folder import check_writable
    from deepkoco.output.whole_file import system_error, writing
    from deepkoco.systems import one_joint
    from deepkoco.unit.unit_file import UnitSpecError, load_unit

    clock = "simulated" if args.simulated else "wall"
    try:
        spec = load_unit(args.unit, args.system)
        excitation, rate = args.excitation or "chirp", args.rate
        named, seconds = excitation, 30.0 if args.seconds is None else args.seconds
        if args.commands is not None:
            played = load_commands(args.commands, one_joint(spec.system))
            excitation, named = played.excitation(), args.commands.name
            rate = played.rate_on(spec.sensor.rate_hz) if rate is None else rate
            seconds = played.seconds if args.seconds is None else args.seconds
        elif args.policy is not None:
            excitation, trained_rate = load_policy_excitation(args.policy, spec.system)
            rate = trained_rate if rate is None else rate
        # Checked before the recording, which would otherwise be lost.
        with writing(out):
            out.parent.mkdir(parents=True, exist_ok=True)
        check_writable(out)
        with _progress(seconds, wanted=clock == "wall") as progress:
            recording = record(
                spec,
                excitation,
                seconds,
                control_rate=rate,
                clock=clock,
                seed=args.seed,
                amplitude=args.amplitude,
                meta={"excitation": named},
                progress=progress,
            )
        write_log(out, recording)
    except (UnitSpecError, ExcitationError, CommandFileError, RecordError, LogError) as error:
        raise InputError(str(error)) from error
    except KeyboardInterrupt as interrupt:
        raise KeyboardInterrupt(f"{out} is written" if out.exists() else "nothing is written") from interrupt
    except OSError as error:
        raise InputError(system_error(error)) from error
    _report(out, recording)
    return 0


def _report(out: Path, recording: Recording) -> None:
    from rich.console import Console

    from deepkoco.logs.inspect.log_summary import summary_table

    console = Console()
    console.print(summary_table(out, recording))
    lost = recording.meta["samples_lost"]
    if lost:
        console.print(f"[yellow]{lost} samples of the sensor were lost[/yellow]: the machine was busy")


@contextmanager
def _progress(seconds: float, wanted: bool) -> Iterator[Callable[[float], None] | None]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not (wanted and console.is_terminal):
        yield None
        return
    columns = (
        TextColumn("recording"),
        BarColumn(),
        TextColumn("{task.completed:.1f} s"),
        TimeRemainingColumn(),
    )
    # The loop of the recorder draws the bar, because a thread would delay time stamps at random.
    with Progress(*columns, console=console, auto_refresh=False, transient=True) as bar:
        task = bar.add_task("recording", total=seconds)
        shown = 0.0

        def update(t: float) -> None:
            nonlocal shown
            if t - shown >= BETWEEN_UPDATES:
                shown = t
                bar.update(task, completed=t, refresh=True)

        yield update
