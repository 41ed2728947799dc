"""Exported tables hold everything on one time axis and read back bit for bit."""

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given, settings

from deepkoco.graph import Connection, Episode, Graph, Supervisor
from deepkoco.graph.episodes.export import episode_table, export_episodes
from deepkoco.graph.episodes.storage import EpisodeFileError, RecordedNode
from tests.graph.episodes.test_round_trip import recorded
from tests.graph.timing_reference import graphs

GRAPH = Graph(
    [RecordedNode("world", 10, kind="X"), Supervisor(rate=5, initial_action=torch.zeros(1))],
    [Connection("world", "agent")],
)
EPISODE = Episode(
    t_start={"world": np.array([0.0, 0.1, 0.1]), "agent": np.array([0.12])},
    t_end={"world": np.array([0.05, 0.1, 0.1]), "agent": np.array([0.12])},
    outputs={"world": np.array([[True, False], [False, True], [True, True]])},
    t_sent={"world->agent": np.array([0.05, 0.1, 0.1])},
    t_received={"world->agent": np.array([0.1, np.inf, 0.2])},
    windows={"world->agent": np.array([[0]])},
)


def test_every_instant_has_a_row_and_two_steps_at_one_instant_have_two():
    table = episode_table(GRAPH, EPISODE)
    assert table["time_s"].tolist() == [0.05, 0.1, 0.1, 0.12, 0.2]
    assert table["world/seq"].tolist() == [0, 1, 2, pd.NA, pd.NA]
    assert table["world/output/1"].tolist() == [0, 1, 1, pd.NA, pd.NA]
    assert table["world->agent/seq"].dropna().to_dict() == {1: 0, 4: 2}
    assert table["world->agent/communication_delay_s"].dropna().tolist() == [0.1 - 0.05, 0.2 - 0.1]
    assert table["world->agent/lost_seq"].dropna().to_dict() == {1: 1}
    assert table["world->agent/age_s"].dropna().to_dict() == {3: 0.12 - 0.05}


def read(path):
    if path.suffix == ".csv":
        return pd.read_csv(path, engine="pyarrow")
    return pd.read_parquet(path)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@settings(max_examples=8, deadline=None)
@given(graph=graphs())
def test_pandas_reads_back_every_output_and_time(graph, suffix, tmp_path_factory):
    episodes, _ = recorded(graph, 3)
    path = tmp_path_factory.mktemp("run") / f"run{suffix}"
    export_episodes(path, graph, episodes, 1)
    table = read(path)
    assert table["time_s"].is_monotonic_increasing
    for name, output in episodes[1].outputs.items():
        rows = table[table[f"{name}/seq"].notna()].sort_values(f"{name}/seq")
        np.testing.assert_array_equal(rows["time_s"], episodes[1].t_end[name])
        flat = output.reshape(len(output), -1)
        for i in range(flat.shape[1]):
            found = rows[f"{name}/output/{i}"].to_numpy(dtype=np.float64)[: len(output)]
            np.testing.assert_array_equal(found, flat[:, i].astype(np.float64))
    for key, received in episodes[1].t_received.items():
        there = received[np.isfinite(received)]
        if f"{key}/seq" in table:
            times = table["time_s"][table[f"{key}/seq"].notna()]
            np.testing.assert_array_equal(times, np.sort(there))


def test_several_episodes_follow_each_other_on_one_axis(tmp_path):
    table = read(export_episodes(tmp_path / "run.csv", GRAPH, [EPISODE, EPISODE]))
    assert table["time_s"].is_monotonic_increasing
    assert table["episode"].tolist() == [0] * 5 + [1] * 5
    assert table["episode_time_s"].tolist() == [0.05, 0.1, 0.1, 0.12, 0.2] * 2
    assert table["time_s"].tolist()[5] == pytest.approx(0.2 + 1.0 + 0.05)


@pytest.mark.parametrize(
    ("name", "episode", "match"),
    [
        ("run.xlsx", None, r'format "\.xlsx" is not known; known: \.csv, \.parquet'),
        ("there/run.csv", None, "no folder"),
        ("run.csv", 2, "there is no episode 2; the recording has 1"),
        ("run.csv", -1, "there is no episode -1"),
    ],
)
def test_what_cannot_be_exported_is_refused(tmp_path, name, episode, match):
    with pytest.raises(EpisodeFileError, match=match):
        export_episodes(tmp_path / name, GRAPH, [EPISODE], episode)
    assert not list(tmp_path.iterdir())


def test_an_export_is_never_written_over_another_file(tmp_path):
    export_episodes(tmp_path / "run.csv", GRAPH, [EPISODE])
    with pytest.raises(EpisodeFileError, match="exists"):
        export_episodes(tmp_path / "run.csv", GRAPH, [EPISODE])
    assert [path.name for path in tmp_path.iterdir()] == ["run.csv"]
