"""What the slots of a timing run, and when."""

import numpy as np
import pytest
from random_graphs import masked_execution, plain_execution, random_timing

from deepkoco.graph.supergraph import join_slots, merge_slots
from tests.studied import studied


def assert_equal(timing, merged) -> None:
    for row, outputs in enumerate(masked_execution(timing, merged)):
        assert outputs == plain_execution(timing, row)  # every step, to the last bit


@pytest.mark.parametrize("block", studied(range(10), range(3)))
def test_masked_execution_equals_execution_one_step_after_the_other_bitwise(block):
    for seed in range(100 * block, 100 * block + 100):
        first, second = random_timing(seed)
        merged = merge_slots(first)
        assert_equal(first, merged)
        if seed % 4 == 0:
            assert_equal(second, merge_slots(second, merged.slots))


def test_known_slots_are_kept_and_only_added_to():
    for seed in range(40):
        first, second = random_timing(seed)
        merged = merge_slots(first)
        again = merge_slots(first, merged.slots)
        for one, other in zip(merged, again, strict=True):
            np.testing.assert_array_equal(one, other)
        fresh = merge_slots(second, merged.slots)
        rest = iter(fresh.slots.tolist())
        assert all(kind in rest for kind in merged.slots.tolist())


def test_what_is_running_keeps_its_table_when_others_join():
    for seed in range(40):
        first, second = random_timing(seed)
        running = merge_slots(first)
        fresh = merge_slots(second, running.slots)
        joined = join_slots(running.take(np.array([2, 0])), fresh.take(np.array([1])))
        for place, (merged, row) in enumerate([(running, 2), (running, 0), (fresh, 1)]):
            for j in range(first.steps + 1):
                ran = [(n, k) for n, k in zip(joined.slots, joined.table[place, j], strict=True) if k >= 0]
                before = [(n, k) for n, k in zip(merged.slots, merged.table[row, j], strict=True) if k >= 0]
                assert ran == before
            np.testing.assert_array_equal(joined.executed[place], merged.executed[row])


def test_slots_that_lack_those_of_what_runs_are_refused():
    first, second = next(p for p in map(random_timing, range(99)) if len(merge_slots(p[0]).slots) > 2)
    running = merge_slots(first)
    with pytest.raises(ValueError, match="do not contain"):
        join_slots(running, merge_slots(second)._replace(slots=running.slots[:1]))


def test_executed_counts_what_the_table_has_run():
    for seed in range(20):
        timing, _ = random_timing(seed)
        merged = merge_slots(timing)
        for n in range(len(timing.layout.names)):
            ran = (merged.table[:, :, merged.slots == n] >= 0).sum(axis=2).cumsum(axis=1)
            if n == timing.layout.supervisor:
                ran += np.arange(timing.steps + 1)
            np.testing.assert_array_equal(merged.executed[:, :, n], ran)


def test_no_step_runs_more_than_one_pass_ahead_and_all_have_run_in_the_end():
    for seed in range(60):
        timing, _ = random_timing(seed)
        executed = merge_slots(timing).executed
        ahead = np.concatenate([timing.boundary[:, 1:], timing.boundary[:, -1:]], axis=1)
        assert (executed <= ahead).all()
        np.testing.assert_array_equal(executed[:, -1], timing.boundary[:, -1])
