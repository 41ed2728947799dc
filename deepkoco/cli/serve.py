"""`deepkoco serve`: run the nodes at a robot for another machine that leads."""

from __future__ import annotations

import argparse
import sys
import threading
from pathlib import Path

from deepkoco.cli.input_error import InputError

DESCRIPTION = """\
Run some nodes of a graph on the machine of the robot, for a machine that leads (`deepkoco lead`). GRAPH.py has a
function graph() that returns the graph, the same file on both machines. After each session, and when the connection
ends, falls silent or a node fails, all nodes are closed, which leaves hardware safe; then the next connection is
awaited. There is no password: whoever reaches the port moves the robot. Listen on 127.0.0.1 (the default) and reach it
through an SSH tunnel, or on a network of your own."""
EXAMPLE = """\
example, in two terminals:
  deepkoco serve docs/examples/two_machines.py --nodes world,sensor --record robot
  deepkoco lead  docs/examples/two_machines.py --to 127.0.0.1:7411 --seconds 10 --record run.mcap"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco serve`."""
    parser.add_argument("graph", metavar="GRAPH.py", help="file with a function graph()")
    parser.add_argument(
        "--nodes",
        required=True,
        metavar="A,B",
        help="nodes that run here; the leading machine has all others",
    )
    parser.add_argument(
        "--listen", default="127.0.0.1:7411", metavar="HOST:PORT", help="address (default: 127.0.0.1:7411)"
    )
    parser.add_argument(
        "--setup", type=Path, metavar="SETUP.yaml",
        help="rates, delays, windows and parameters in the place of those of the file",
    )  # fmt: skip
    parser.add_argument(
        "--silence", type=float, default=60.0, metavar="MS",
        help="stop if nothing comes for this long, or no message to a node for this long beyond its period "
        "(default: 60 ms)",
    )  # fmt: skip
    parser.add_argument("--record", type=Path, metavar="DIR", help="folder for one recording per session")
    parser.add_argument(
        "--threads",
        default="",
        metavar="A,B",
        help="nodes that share one process (default: each has its own)",
    )
    parser.add_argument("--priority", type=int, metavar="N", help="real-time priority to request, 1 to 99")
    parser.add_argument("--sessions", type=int, metavar="N", help="end after this many (default: no end)")


def seconds_of_silence(milliseconds: float) -> float:
    """Return a limit of silence in seconds.

    Raises:
        InputError: signs of life come too seldom for it.
    """
    from deepkoco.graph.net.link import BEAT_PERIOD

    if not milliseconds > 2e3 * BEAT_PERIOD:
        raise InputError(
            f"--silence {milliseconds:g}: signs of life come every {1e3 * BEAT_PERIOD:g} ms; give more than "
            f"{2e3 * BEAT_PERIOD:g} ms"
        )
    return milliseconds / 1e3


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C.

    Raises:
        InputError: the file, a name, the address or the folder of the recordings cannot be used.
    """
    from deepkoco.graph.episodes.storage.container import EpisodeFileError
    from deepkoco.graph.live.host import take_endings
    from deepkoco.graph.model.node import GraphError
    from deepkoco.graph.net.failure import ConnectionRefused
    from deepkoco.graph.net.graph_file import read_graph_file
    from deepkoco.graph.net.robot_end import RobotEnd, RobotOptions
    from deepkoco.graph.setup import SetupError
    from deepkoco.own_objects import OwnObjectError

    nodes, threads = (tuple(filter(None, text.split(","))) for text in (args.nodes, args.threads))
    silence = seconds_of_silence(args.silence)
    try:
        file = read_graph_file(args.graph, args.setup)
        options = RobotOptions(
            threads=threads,
            factories=file.factories(set(nodes)),
            priority=args.priority,
            silence=silence,
            record=args.record,
        )
        with RobotEnd(file.graph, nodes, args.listen, options, _say) as end:
            if threading.current_thread() is threading.main_thread():
                take_endings(
                    lambda _: end.close()
                )  # a service manager that ends it, or a terminal that closes
            end.serve(args.sessions)
    except (OwnObjectError, SetupError, GraphError, ConnectionRefused, EpisodeFileError) as error:
        raise InputError(str(error)) from error
    return 0


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
