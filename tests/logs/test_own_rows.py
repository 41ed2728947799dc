"""A table that joins messages of several rates: each column has rows of its own."""

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect.survey import survey_log
from deepkoco.logs.own_rows import has_own_rows
from deepkoco.logs.recording import LogError, read_log

SECONDS = 4.0


def stamps(rate, jitter, offset, rng):
    """Stamps of one message, off by at most a share of its period."""
    t = offset + np.arange(round(SECONDS * rate)) / rate
    return t + jitter / rate * rng.uniform(-0.5, 0.5, len(t))


def joined(columns):
    """Rows of all messages in their order, empty where a column has no sample."""
    time = np.concatenate([t for t, _ in columns])
    table = np.full((len(time), len(columns)), np.nan)
    first = 0
    for c, (t, value) in enumerate(columns):
        table[first : first + len(t), c] = value
        first += len(t)
    order = np.argsort(time, kind="stable")
    return time[order], table[order]


@settings(deadline=None)
@given(
    st.lists(st.sampled_from([20.0, 50.0, 100.0, 250.0]), min_size=2, max_size=4),
    st.floats(0.0, 0.3),
    st.integers(0, 10_000),
)
def test_every_column_of_joined_messages_has_own_rows(rates, jitter, seed):
    rng = np.random.default_rng(seed)
    columns = [
        (t := stamps(rate, jitter, rng.uniform(0.1, 0.2), rng), rng.standard_normal(len(t))) for rate in rates
    ]
    time, table = joined(columns)
    for column in table.T:
        assert has_own_rows(time, np.isnan(column))


@settings(deadline=None)
@given(st.floats(0.01, 0.7), st.floats(0.0, 0.3), st.integers(0, 10_000))
def test_samples_missing_at_random_are_no_rate_of_their_own(share, jitter, seed):
    rng = np.random.default_rng(seed)
    time = stamps(200.0, jitter, 0.0, rng)
    assert not has_own_rows(time, rng.uniform(size=len(time)) < share)


def written(folder, time, table, names):
    path = folder / "log.csv"
    cells = [
        [f"{t:.6f}", *("" if np.isnan(v) else f"{v:.6f}" for v in row)]
        for t, row in zip(time, table, strict=True)
    ]
    path.write_text("\n".join(",".join(row) for row in [["t", *names], *cells]) + "\n")
    kinds = dict.fromkeys(names, ("rad", "measurement")) | {"torque": ("N m", "command")}
    channels = {n: {"column": n, "unit": u, "kind": k} for n, (u, k) in kinds.items()}
    path.with_suffix(".yaml").write_text(
        yaml.safe_dump({"time": {"column": "t", "unit": "s"}, "channels": channels})
    )
    return path


def test_joined_messages_are_read_like_files_of_their_own(tmp_path):
    rng = np.random.default_rng(1)
    command, angle = stamps(50.0, 0.1, 0.013, rng), stamps(200.0, 0.1, 0.0, rng)
    values = (rng.standard_normal(len(command)), np.sin(angle))
    # One command in a hundred is lost, and one sample in twenty.
    sent, seen = rng.uniform(size=len(command)) > 0.01, rng.uniform(size=len(angle)) > 0.05
    columns = [(command[sent], values[0][sent]), (angle[seen], values[1][seen])]
    path = written(tmp_path, *joined(columns), ("torque", "theta"))
    recording = read_log(path)
    for name, (t, value) in zip(("torque", "theta"), columns, strict=True):
        series = recording.channels[name]
        np.testing.assert_allclose(np.diff(series.t), np.diff(t), atol=2e-6)
        np.testing.assert_allclose(series.value, value, atol=1e-6)
        assert series.unknown is None
    assert all(column.missing == 0 for column in survey_log(open_log(path)).columns)


def test_a_command_missing_here_and_there_in_a_table_of_one_rate_is_refused(tmp_path):
    rng = np.random.default_rng(2)
    t = stamps(100.0, 0.0, 0.0, rng)
    torque = np.where(rng.uniform(size=len(t)) < 0.05, np.nan, rng.standard_normal(len(t)))
    path = written(tmp_path, t, np.column_stack([torque, np.sin(t)]), ("torque", "theta"))
    with pytest.raises(LogError, match="NaN or infinite"):
        read_log(path)


def test_messages_at_any_times_have_own_rows_where_each_row_is_of_one_of_them(tmp_path):
    rng = np.random.default_rng(3)
    angle = np.cumsum(rng.uniform(0.004, 0.03, 300))  # a sensor that reports when it can
    command = np.arange(0.0, angle[-1], 0.02)
    time, table = joined([(command, rng.standard_normal(len(command))), (angle, np.sin(angle))])
    recording = read_log(written(tmp_path, time, table, ("torque", "theta")))
    assert len(recording.channels["theta"]) == len(angle)
    assert recording.channels["torque"].unknown is None
    said = [note for note in recording.warnings if "rows of other columns" in note]
    assert len(said) == 1
    assert '"torque"' in said[0]
    assert '"theta"' in said[0]


@given(st.floats(0.05, 0.6), st.floats(0.05, 0.6), st.integers(0, 10_000))
def test_cells_missing_from_two_columns_at_random_are_missing(first, second, seed):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.004, 0.03, 800))
    missing = rng.uniform(size=(800, 2)) < (first, second)
    others = ~missing
    assert not has_own_rows(time, missing[:, 0], others[:, 1:])


def test_two_messages_of_one_stamp_are_no_repetition(tmp_path):
    t = np.arange(0.0, 3.0, 0.01)
    time, table = joined([(t, np.cos(t)), (t, np.sin(t))])
    path = written(tmp_path, time, table, ("torque", "theta"))
    assert survey_log(open_log(path)).clocks[""][0].duplicates == 0
    assert len(read_log(path).channels["theta"]) == len(t)
