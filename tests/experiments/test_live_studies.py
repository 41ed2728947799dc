"""The studies of the concurrent and the wall-clock runtime, small, as a user calls them."""

import pandas as pd
import pytest

from experiments.studies.graph import asynchronous_drift, real_time_factor, wall_clock_timing

SMALL = {
    asynchronous_drift: ("--factors", "20", "--seconds", "1", "--repetitions", "1"),
    real_time_factor: ("--computation", "4", "--steps", "8", "--repetitions", "1"),
    wall_clock_timing: ("--rate", "50", "--seconds", "0.4"),
}


@pytest.fixture(scope="module", params=SMALL, ids=lambda study: study.__name__.split(".")[-1])
def result(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("studies") / "result"
    assert request.param.main(["--out", str(folder), *SMALL[request.param]]) == 0
    return request.param, folder


def test_a_study_leaves_tables_figures_and_a_readme(result, capsys):
    study, folder = result
    names = {path.name for path in folder.iterdir()}
    assert "README.md" in names
    for figure in (name for name in names if name.endswith(".png")):
        assert len(pd.read_csv(folder / figure.replace(".png", ".csv"))) > 0
        assert f"({figure})" in (folder / "README.md").read_text()
    assert "| load average before, after |" in (folder / "README.md").read_text()
    assert study.main(["--out", str(folder)]) == 2
    assert capsys.readouterr().err.startswith(f"error: {folder}: exists")


def test_a_study_measures_what_it_says(result):
    study, folder = result
    if study is asynchronous_drift:
        table = pd.read_csv(folder / "asynchronous_drift.csv")
        assert table[table.synchronised].largest_drift_rad.tolist() == [0.0]
        assert (table[~table.synchronised].largest_drift_rad > 0).all()
    elif study is real_time_factor:
        table = pd.read_csv(folder / "real_time_factor.csv")
        # What computes at the same time, or one after the other, is at least so slow; with a delay the world is
        # one of the eight steps ahead when the measurement begins.
        assert (table.real_time_factor < table.at_the_same_time * 8 / 7 * 1.01).all()
        alone = table[table.delay_periods == 0]
        assert (alone.real_time_factor < alone.one_after_the_other * 1.01).all()
    else:
        nodes, ways = (pd.read_csv(folder / f"{name}.csv") for name in ("lateness", "messages"))
        assert set(nodes.node) == {"world", "sensor", "filter", "agent"}
        assert (nodes.ticks >= 20).all()
        assert (nodes.lateness_ms_median > 0).all()
        assert (ways.lost == 0).all()
