"""`deepkoco lead`: run a graph with a robot on another machine."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from deepkoco.cli.input_error import InputError
from deepkoco.cli.serve import seconds_of_silence

if TYPE_CHECKING:
    from deepkoco.graph import Episode, Graph
    from deepkoco.graph.net import RobotNodes

DESCRIPTION = """\
Run a graph together with the machine of a robot, where `deepkoco serve` has the nodes at the hardware. GRAPH.py has the
functions graph(), policy(inputs) and, if nodes need them, parameters(); the same file on both machines. This machine
has the policy and the clock."""
EXAMPLE = """\
example, in two terminals:
  deepkoco serve docs/examples/two_machines.py --nodes world,sensor --record robot
  deepkoco lead  docs/examples/two_machines.py --to 127.0.0.1:7411 --seconds 10 --record run.mcap"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco lead`."""
    parser.add_argument(
        "graph", metavar="GRAPH.py", help="file with functions graph(), policy() and parameters()"
    )
    parser.add_argument("--to", required=True, metavar="HOST:PORT", help="address of the robot's machine")
    parser.add_argument("--seconds", type=float, default=10.0, help="length of an episode [s] (default: 10)")
    parser.add_argument(
        "--episodes", type=int, default=1, metavar="N", help="number of episodes (default: 1)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the initial states (default: 0)")
    parser.add_argument(
        "--setup", type=Path, metavar="SETUP.yaml",
        help="rates, delays, windows and parameters in the place of those of the file",
    )  # fmt: skip
    parser.add_argument(
        "--silence", type=float, default=60.0, metavar="MS",
        help="stop if nothing comes from the robot for this long (default: 60 ms)",
    )  # fmt: skip
    parser.add_argument("--record", type=Path, metavar="RUN.mcap", help="recording of both machines")


def run(args: argparse.Namespace) -> int:
    """Lead the robot through the episodes.

    Raises:
        InputError: the file, the robot or the place of the recording cannot be used.
        UnitError: the robot, a node or the connection failed.
    """
    import torch

    from deepkoco.graph.episodes.storage.container import EpisodeFileError
    from deepkoco.graph.live import NodeFailure, WallClockRuntime
    from deepkoco.graph.net import ConnectionRefused, connect
    from deepkoco.graph.net.graph_file import read_graph_file
    from deepkoco.graph.setup import SetupError
    from deepkoco.own_objects import OwnObjectError
    from deepkoco.unit.messages import UnitError

    if args.episodes < 1 or not args.seconds > 0:
        raise InputError(f"--episodes {args.episodes} of --seconds {args.seconds:g}: give more than 0")
    silence = seconds_of_silence(args.silence)
    try:
        file = read_graph_file(args.graph, args.setup)
        graph, policy, parameters = file.graph, file.policy(), file.parameters()
        steps = max(1, round(args.seconds * float(graph.node(graph.supervisor).rate)))
        generator = torch.Generator().manual_seed(args.seed)
        away = connect(graph, args.to, silence)
        own = frozenset(graph.index) - away.nodes - {graph.supervisor}
        record = True if args.record is None else args.record
        with WallClockRuntime(graph, factories=file.factories(own), record=record, away=away) as runtime:
            for number in range(args.episodes):
                runtime.reset(parameters, generator)
                runtime.run(policy, steps)
                episode = runtime.finish()
                _report(number, graph, episode, away)
    except (OwnObjectError, SetupError, ConnectionRefused, EpisodeFileError) as error:
        raise InputError(str(error)) from error
    except NodeFailure as failure:
        raise UnitError(str(failure) + _where(args.record)) from failure
    except KeyboardInterrupt as interrupt:
        raise KeyboardInterrupt(f"all nodes are closed{_where(args.record)}") from interrupt
    if args.record is not None:
        sys.stdout.write(
            f"{args.record}: recording of both machines; `deepkoco show {args.record}` describes it\n"
        )
    return 0


def _where(record: Path | None) -> str:
    if record is None:
        return ""
    return (
        f"; {record} has what is known here. If the robot's end recorded (`deepkoco serve --record`), `deepkoco merge` "
        "puts the two together"
    )


def _report(number: int, graph: Graph, episode: Episode, away: RobotNodes) -> None:
    from deepkoco.graph.live import message_times, node_times

    late = {name: node_times(graph, episode, name) for name in graph.index}
    lost = {c.key: message_times(graph, episode, c.key) for c in graph.connections}
    _, uncertainty = away.link.far_correction
    text = (
        f"episode {number}: {late[graph.supervisor].steps - 1} steps, "
        f"{sum(times.overruns for times in late.values())} overruns, "
        f"{sum(times.lost for times in lost.values())} of {sum(times.sent for times in lost.values())} messages lost, "
        f"clocks known to {uncertainty / 1e6:.3f} ms, longest silence {away.link.counts.longest_silence * 1e3:.0f} ms\n"
    )
    sys.stdout.write(text)
    sys.stdout.flush()
