"""`deepkoco merge`: one recording out of those of two machines."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from deepkoco.cli.input_error import InputError

DESCRIPTION = """\
Put the recordings of the two machines of one session together, where the connection ended before the run did. After a
run that ends as it should, the recording of `deepkoco lead` has both already. All times are on the clock of the machine
that leads. An episode goes as far as both files know of it."""
EXAMPLE = """\
example:
  deepkoco merge run.mcap robot/session_0000.mcap --out merged.mcap
  deepkoco merge run.mcap.partial robot/session_0000.mcap --out merged.mcap     the leading program was killed"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco merge`."""
    parser.add_argument("leader", type=Path, metavar="LEADER.mcap", help="recording of `deepkoco lead`")
    parser.add_argument(
        "robot", type=Path, metavar="ROBOT.mcap", help="recording of `deepkoco serve --record`"
    )
    parser.add_argument("--out", required=True, type=Path, metavar="MERGED.mcap", help="recording to write")


def run(args: argparse.Namespace) -> int:
    """Merge.

    Raises:
        InputError: the recordings cannot be read, do not belong together, or the target exists.
    """
    from deepkoco.graph.episodes.storage.container import EpisodeFileError
    from deepkoco.graph.episodes.storage.read import read_episodes
    from deepkoco.graph.net.merge import merge_recordings

    try:
        out = merge_recordings(args.leader, args.robot, args.out)
        run = read_episodes(out)
    except EpisodeFileError as error:
        raise InputError(str(error)) from error
    steps = sum(len(times) for episode in run.episodes for times in episode.t_start.values())
    sys.stdout.write(
        f"{out}: {len(run.episodes)} episode{'s' * (len(run.episodes) != 1)}, {steps} steps of both\n"
    )
    for reason in run.meta.get("left_out", ()):
        sys.stdout.write(f"left out: {reason}\n")
    return 0
