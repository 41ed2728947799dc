"""The study of the time of healthy units: its units follow from their names."""

import numpy as np
import pytest

from experiments.studies.diagnosis.clean_time import unit_of


@pytest.mark.parametrize(("name", "healthy"), [("motor:0:15:3", 0), ("servo:1:15:3", 1)])
def test_a_unit_is_healthy_and_follows_from_its_name(name, healthy, tmp_path):
    first, again = (unit_of(name).question(tmp_path / part).handed for part in ("a", "b"))
    assert len(first.healthy) == healthy
    (log,), (same,) = first.log, again.log
    assert log.channels.keys() == same.channels.keys()
    for channel, series in log.channels.items():
        np.testing.assert_array_equal(series.value, same.channels[channel].value)
    assert unit_of(name).hidden is None
