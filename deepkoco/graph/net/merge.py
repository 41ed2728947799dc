"""One recording out of those of the two ends, where the connection ended before they could become one by themselves."""

from pathlib import Path

import numpy as np

from deepkoco.graph.episodes.episode import Episode, Note, common_part
from deepkoco.graph.episodes.storage.container import EpisodeFileError
from deepkoco.graph.episodes.storage.read import RecordedRun, read_episodes
from deepkoco.graph.episodes.storage.write import write_episodes
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.net.greeting import comparable


def merge_recordings(leader: str | Path, robot: str | Path, out: str | Path) -> Path:
    """Put the recordings of both ends of a session together.

    The times of both are on one clock, that of the end that leads: the robot's end has kept it while it ran. Each
    node and each arrival is taken from the end where it was. An episode goes as far as both ends know of it; it reads
    and replays like one of a single machine.

    Args:
        leader: of the end that leads; `.mcap`, or the `.mcap.partial` that a killed one leaves.
        robot: of the robot's end, likewise.
        out: file to write, `.mcap`.

    Returns:
        The path of the merged recording.

    Raises:
        EpisodeFileError: a file cannot be read, they are not of one session, or they have no common part.
    """
    ends = [read_episodes(path, partial=Path(path).suffix == ".partial") for path in (leader, robot)]
    _check(*ends)
    first, second = ends
    begun = {origin: number for number, origin in enumerate(second.origins)}
    here = set(first.graph.index) - set(first.meta["robot_nodes"])
    episodes, reasons = [], []
    for number, (origin, episode) in enumerate(zip(first.origins, first.episodes, strict=True)):
        if origin not in begun:
            reasons.append(f"episode {number} has not begun at the robot")
            continue
        other = second.episodes[begun[origin]]
        try:
            # One that both ends have in full, because the connection lasted, is there already.
            whole = all(len(start) for start in episode.t_start.values())
            merged = episode if whole else common_part(first.graph, joined(first.graph, episode, other, here))
        except ValueError as error:
            reasons.append(f"episode {number}: {error}")
            continue
        episodes.append(merged)
    if not episodes:
        raise EpisodeFileError(
            f"{leader} and {robot}: there is nothing to merge: {'; '.join(reasons) or 'they hold no episode'}"
        )
    meta = {"session": first.meta["session"], "end": "both", "robot_nodes": first.meta["robot_nodes"]}
    return write_episodes(out, first.graph, episodes, meta | ({"left_out": reasons} if reasons else {}))


def joined(graph: Graph, first: Episode, second: Episode, here: set[str]) -> Episode:
    """Join what two ends know of an episode.

    Args:
        graph: what ran.
        first, second: of the end that leads, and of the robot's.
        here: names of the nodes of the first.

    Returns:
        All steps of all nodes; of a message that was sent and has not come, the arrival is infinity.
    """
    ends = {name: first if name in here else second for name in graph.index}
    outputs = {name: end.outputs[name] for name, end in ends.items() if name in end.outputs}
    sent, received, windows = {}, {}, {}
    for c in graph.connections:
        sent[c.key] = ends[c.sender].t_end[c.sender][: len(outputs.get(c.sender, ()))]
        received[c.key] = np.full(len(sent[c.key]), np.inf)
        arrived = ends[c.receiver].t_received[c.key][: len(sent[c.key])]
        received[c.key][: len(arrived)] = arrived
        if c.key in ends[c.receiver].windows:
            windows[c.key] = ends[c.receiver].windows[c.key]
    notes = [Note(n.t, n.level, n.node, f"(robot) {n.text}") for n in second.notes]
    return Episode(
        {name: end.t_start[name] for name, end in ends.items()},
        {name: end.t_end[name] for name, end in ends.items()},
        outputs,
        sent,
        received,
        windows,
        tuple(sorted((*first.notes, *notes), key=lambda note: note.t)),
        first.failure or second.failure,
    )


def _check(leader: RecordedRun, robot: RecordedRun) -> None:
    for run, end in ((leader, "leader"), (robot, "robot")):
        if run.meta.get("end") == "both":
            raise EpisodeFileError(f"{run.path}: is merged already")
        if run.meta.get("end") != end:
            named = "the end that leads" if end == "leader" else "the robot's end"
            raise EpisodeFileError(
                f"{run.path}: is no recording of {named}; give first the leader's, then the robot's"
            )
    if leader.meta["session"] != robot.meta["session"]:
        raise EpisodeFileError(
            f"{leader.path} and {robot.path}: are of two sessions ({leader.meta['session']} and "
            f"{robot.meta['session']}); the recording at the robot has the session of the leader's in its description "
            "(`deepkoco show`)"
        )
    if comparable(leader.graph) != comparable(robot.graph):
        raise EpisodeFileError(f"{leader.path} and {robot.path}: are of two graphs")
