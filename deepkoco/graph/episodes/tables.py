"""Tables of an episode: what happened to every step and message, and all delays by where they arose."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.model.graph import Graph


def steps_table(graph: Graph, episode: Episode) -> pd.DataFrame:
    """Tell of every step when it ran, whether it overran its period and how long its node was late.

    Returns:
        Columns node, seq, t_start_s, t_end_s, overrun (its computation took longer than a period), late_s (how
        much more than a period, and more than half of one more, has passed since the start of the step before).
    """
    rows = []
    for node in graph.nodes:
        begin, end = episode.t_start[node.name], episode.t_end[node.name]
        period = float(1 / node.rate)
        late = np.diff(begin, prepend=begin[:1]) - period
        rows.append(
            pd.DataFrame(
                {
                    "node": node.name,
                    "seq": np.arange(len(begin)),
                    "t_start_s": begin,
                    "t_end_s": end,
                    "overrun": end - begin > period * (1 + 1e-9),
                    "late_s": np.where(late > 0.5 * period, late, 0.0),
                }
            )
        )
    return pd.concat(rows, ignore_index=True)


def messages_table(graph: Graph, episode: Episode) -> pd.DataFrame:
    """Tell of every message when it was sent, received and first seen.

    Returns:
        Columns connection, seq, t_sent_s, t_received_s (empty: it never arrived), used_by (step of the
        receiver, -1: none), t_used_s.
    """
    rows = [pd.DataFrame({"connection": [], "seq": [], "t_sent_s": [], "t_received_s": [], "used_by": []})]
    for c in graph.connections:
        count = len(episode.t_sent[c.key])
        used = np.full(count, -1)
        windows = episode.windows.get(c.key, np.zeros((0, c.window), dtype=np.int64))
        # From the last step to the first: the first that saw it is what stays.
        for step in range(len(windows) - 1, -1, -1):
            seen = windows[step]
            used[seen[(seen >= 0) & (seen < count)]] = step
        at = np.append(episode.t_start[c.receiver], np.nan)[used]
        received = np.where(np.isinf(episode.t_received[c.key]), np.nan, episode.t_received[c.key])
        content = {"connection": c.key, "seq": np.arange(count), "t_sent_s": episode.t_sent[c.key]}
        rows.append(pd.DataFrame(content | {"t_received_s": received, "used_by": used, "t_used_s": at}))
    filled = [row for row in rows[1:] if len(row)]
    return pd.concat(filled, ignore_index=True) if filled else rows[0].assign(t_used_s=[])


def measured_delays(graph: Graph, episodes: Iterable[Episode]) -> dict[str, np.ndarray]:
    """Collect delays [s] by node name (computation) and connection key (communication), infinity for lost.

    The last step of the supervisor, whose end is not part of an episode, does not count.
    """
    found: dict[str, list[np.ndarray]] = {
        key: [] for key in (*graph.index, *(c.key for c in graph.connections))
    }
    for episode in episodes:
        for name in graph.index:
            taken = episode.t_end[name] - episode.t_start[name]
            found[name].append(taken[: len(taken) - (name == graph.supervisor)])
        for c in graph.connections:
            found[c.key].append(episode.t_received[c.key] - episode.t_sent[c.key])
    return {key: np.concatenate([np.zeros(0), *parts]) for key, parts in found.items()}
