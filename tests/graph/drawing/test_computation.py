"""Computation graphs and supergraphs are drawn whole, with the right shares."""

import numpy as np
import pytest
import torch
from matplotlib.collections import LineCollection, PatchCollection

from deepkoco.graph import Connection, Graph, Supervisor, draw_timing
from deepkoco.graph.drawing import draw_computation_graph, draw_supergraph
from deepkoco.graph.drawing.computation import slot_table
from deepkoco.graph.episodes.storage import RecordedNode
from deepkoco.graph.supergraph import MergedSlots, merge_slots

GRAPH = Graph(
    [RecordedNode("world", 20, kind="X"), Supervisor(rate=10, initial_action=torch.zeros(1))],
    [Connection("world", "agent"), Connection("agent", "world", skip=True)],
)


def test_every_vertex_and_edge_up_to_the_last_step_is_drawn():
    timing = draw_timing(GRAPH, np.random.default_rng(0), 3, batch=1)
    picture = draw_computation_graph(timing, steps=2)
    # world runs at 0, 0.05, ..., 0.2; the agent at 0, 0.1, 0.2. The agent sees world steps 0, 2 and 4; the
    # action of agent step 0 is seen by world steps 1, 2 and that of step 1 by 3, 4.
    table = picture.table
    steps = table[table.kind == "step"]
    assert sorted(zip(steps.node, steps.seq, steps.partition, strict=True)) == [
        *[("agent", k, k) for k in range(3)],
        *zip(["world"] * 5, range(5), [0, 1, 1, 2, 2], strict=True),
    ]
    used = table[table.kind == "message"]
    assert sorted(zip(used["from"], used.from_seq.astype(int), used.node, used.seq, strict=True)) == [
        ("agent", 0, "world", 1),
        ("agent", 0, "world", 2),
        ("agent", 1, "world", 3),
        ("agent", 1, "world", 4),
        ("world", 0, "agent", 0),
        ("world", 2, "agent", 1),
        ("world", 4, "agent", 2),
    ]
    axes = picture.figure.axes[0]
    lines = {c.get_label(): len(c.get_segments()) for c in axes.collections if isinstance(c, LineCollection)}
    assert lines == {"state": 6, "message": 7}
    assert len(axes.collections[-1].get_offsets()) == 8


def test_slots_show_in_what_share_of_passes_they_run():
    table = np.array([[[0, -1, 0], [1, 2, 1]], [[0, 1, -1], [-1, -1, -1]]])
    merged = MergedSlots(
        np.array([0, 0, 1]), table, np.ones(3, dtype=np.int64), *[table] * (len(MergedSlots._fields) - 3)
    )
    names = ["world", "sensor", "agent"]
    assert slot_table(names, merged, 2).to_dict("list") == {
        "slot": [0, 1, 2, 3],
        "node": ["world", "world", "sensor", "agent"],
        "utilisation": [0.75, 0.5, 0.5, 1.0],
    }
    picture = draw_supergraph(names, merged, 2)
    above, axes = picture.figure.axes
    assert [bar.get_height() for bar in above.patches] == [75, 50, 50, 100]
    frames, filled = (c for c in axes.collections if isinstance(c, PatchCollection))
    shares = [
        f.get_extents().height / w.get_extents().height
        for w, f in zip(frames.get_paths(), filled.get_paths(), strict=True)
    ]
    assert shares == pytest.approx([0.75, 0.5, 0.5, 1.0])
    assert above.get_title() == "4 slots, 68.8 % used on average (dashed)"


def test_the_shares_of_a_supergraph_count_every_step_once():
    timing = draw_timing(GRAPH, np.random.default_rng(0), 5, batch=1)
    merged = merge_slots(timing)
    table = slot_table(list(GRAPH.index), merged, 1)
    runs = table[table.node == "world"].utilisation.sum() * merged.table.shape[1]
    assert runs == pytest.approx((merged.table >= 0).sum())
