"""Computation graphs written down by hand."""

import numpy as np

from deepkoco.graph.supergraph import Partitions, partition_graphs


def make_parts(*episodes: str) -> Partitions:
    """Pairs of vertices and edges, "S0 a0 a1" and "a0>S0"; kinds are numbered as they come, S first."""
    vertices = [text.split() for text in episodes[::2]]
    edges = [[edge.split(">") for edge in text.split()] for text in episodes[1::2]]
    kinds = ["S", *sorted({name[0] for names in vertices for name in names} - {"S"})]
    first, kind, seq, base, pred = [0], [], [], [0], []
    for names, pairs in zip(vertices, edges, strict=True):
        for name in names:
            kind.append(kinds.index(name[0]))
            seq.append(int(name[1:]))
            pred += [first[-1] + names.index(a) for a, b in pairs if b == name]
            base.append(len(pred))
        first.append(len(kind))
    return partition_graphs(len(kinds), 0, np.array(first), kind, seq, base, pred)
