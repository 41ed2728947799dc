"""Tables and buffers by hand."""

import numpy as np
import torch

from deepkoco.graph import Connection, Graph, Supervisor, draw_timing
from deepkoco.graph.execution.cuda.packing import Packing, clone, load
from deepkoco.graph.execution.cuda.recent import Recent
from deepkoco.graph.execution.cuda.tables import PassTables
from deepkoco.graph.execution.schedule import Schedule
from experiments.benchmarks.rollout_work import Relay


def test_a_line_has_what_slots_run_write_and_read():
    agent = Supervisor("agent", 50, initial_action=torch.zeros(1))
    graph = Graph(
        [Relay("sensor", 1), agent],
        [Connection("agent", "sensor", skip=True, window=2), Connection("sensor", "agent")],
    )
    schedule = Schedule(draw_timing(graph, np.random.default_rng(0), 3, 1))
    tables = PassTables(graph, schedule, torch.device("cpu"))
    # Step k of the sensor sees actions k - 2 and k - 1, so actions need two cells; the agent sees its step k at
    # once, so one cell does for the sensor and there is nothing to look up. Columns: seq, cell written, cells read.
    assert tables.depth == [1, 2]
    assert tables.lines.tolist() == [[0, 0, 0, 1], [1, 0, 1, 0], [2, 0, 0, 1], [3, 0, 1, 0]]
    assert tables.lines.dtype == torch.int16
    ((node, always, (read,)),) = tables.slots
    assert (node, always, read.columns) == (0, True, slice(2, 4))
    assert tables.supervisor[0].columns is None


def test_where_a_slot_has_nothing_to_run_it_writes_beyond_the_ring():
    agent = Supervisor("agent", 20, initial_action=torch.zeros(1))
    # The sensor, at 50 Hz, has two or three steps between those of the agent: 0 | 1 2 | 3 4 5 (the last at 0.1 s).
    graph = Graph(
        [Relay("sensor", 1), agent], [Connection("sensor", "agent"), Connection("agent", "sensor", skip=True)]
    )
    tables = PassTables(
        graph, Schedule(draw_timing(graph, np.random.default_rng(0), 2, 1)), torch.device("cpu")
    )
    count = len(tables.slots)
    seq, cell = tables.lines[:, :count], tables.lines[:, count : 2 * count]
    assert sorted(seq[seq >= 0].tolist()) == list(range(6))
    depth = tables.depth[0]
    assert torch.equal(cell, torch.where(seq >= 0, seq % depth, depth))
    assert [slot.always for slot in tables.slots] == (seq[1:] >= 0).all(0).tolist()


def test_packed_tensors_begin_at_multiples_of_sixteen_bytes():
    tensors = {
        ("a",): torch.arange(3, dtype=torch.float32),
        ("b",): torch.tensor(7.0),
        ("c",): torch.tensor([[True], [False]]),
    }
    packing = Packing({name: (value.dtype, tuple(value.shape)) for name, value in tensors.items()})
    buffers = packing.pack(tensors, torch.device("cpu"))
    assert buffers[torch.float32].tolist() == [0, 1, 2, 0, 7, 0, 0, 0]
    assert buffers[torch.bool].tolist() == [True] + [False] * 15
    for name, view in packing.views(buffers).items():
        assert torch.equal(view, tensors[name])
    own = clone(buffers)
    packing.view(buffers, ("b",)).fill_(9.0)
    assert packing.view(own, ("b",)).item() == 7.0
    load(own, buffers)
    assert packing.view(own, ("b",)).item() == 9.0


def test_what_was_used_last_is_kept():
    made, recent = [], Recent(2)

    def get(key):
        return recent.get(key, lambda: made.append(key) or key)

    assert [get(key) for key in "abacab"] == list("abacab")
    assert made == list("abcb")  # c takes the place of b, which was used longer ago than a
