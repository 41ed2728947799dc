"""`deepkoco show` and `deepkoco export`: numbers, pictures, one line per mistake, nothing overwritten."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from deepkoco.cli.command_line import main
from deepkoco.graph import EpisodeWriter
from deepkoco.graph.episodes.storage import write_episodes
from tests.graph.episodes.test_episode_writer import GRAPH as STREAMED
from tests.graph.episodes.test_export import EPISODE, GRAPH


@pytest.fixture
def recording(tmp_path):
    return str(write_episodes(tmp_path / "run.mcap", GRAPH, [EPISODE], {"robot": "rod"}))


def test_show_tells_rates_delays_and_losses(recording, capsys):
    assert main(["show", recording, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["episodes"], content["complete"], content["meta"]) == (1, True, {"robot": "rod"})
    world = content["nodes"][0]
    # Starts at 0, 0.1 and 0.1 s: two periods in 0.1 s.
    assert (world["steps"], world["rate_hz"], world["realised_hz"]) == (3, 10.0, 20.0)
    assert world["computation"]["mean_s"] == pytest.approx(0.05 / 3)
    message = content["connections"][0]
    assert (message["messages"], message["lost"]) == (3, 1)
    assert message["communication"]["mean_s"] == pytest.approx((0.05 + 0.1) / 2)
    assert message["communication"]["p50_s"] == pytest.approx((0.05 + 0.1) / 2)
    assert main(["show", recording]) == 0
    out = capsys.readouterr().out
    for word in ("world->agent", "realised", "robot: rod", "1 episode"):
        assert word in out


def test_show_says_that_a_failure_ended_an_episode(tmp_path, capsys):
    failed = str(
        write_episodes(tmp_path / "run.mcap", GRAPH, [EPISODE, replace(EPISODE, failure="cable is off")])
    )
    assert main(["show", failed, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["complete"], content["failures"]) == (False, {"1": "cable is off"})
    assert main(["show", failed]) == 0
    out = capsys.readouterr().out
    assert "failed (episode 1): cable is off" in out
    assert "cut off" not in out


def test_show_draws_pictures_and_a_page(recording, tmp_path):
    pictures, page = tmp_path / "pictures", tmp_path / "page.html"
    assert main(["show", recording, "--pictures", str(pictures), "--html", str(page)]) == 0
    names = {"graph", "timeline", "delays", "signals"}
    assert {p.name for p in pictures.iterdir()} == {f"{n}{s}" for n in names for s in (".png", ".csv")}
    assert "run.mcap" in page.read_text()
    assert main(["show", recording, "--html", str(page)]) == 2
    assert main(["show", recording, "--pictures", str(pictures)]) == 2


def test_export_writes_a_table_once(recording, tmp_path, capsys):
    for name in ("run.csv", "run.parquet"):
        assert main(["export", recording, str(tmp_path / name)]) == 0
        assert main(["export", recording, str(tmp_path / name)]) == 2
        assert "exists" in capsys.readouterr().err
    table = pd.read_csv(tmp_path / "run.csv")
    np.testing.assert_array_equal(table["time_s"], pd.read_parquet(tmp_path / "run.parquet")["time_s"])


def test_a_recording_that_was_cut_off_is_shown_on_request(tmp_path, capsys):
    writer = EpisodeWriter(tmp_path / "run.mcap", STREAMED)
    for k in range(20):
        writer.step("world", k, k / 100, (k + 1) / 100, np.zeros(1))
    writer.close()
    content = (tmp_path / "run.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[:-20])
    for command in (["show", str(cut)], ["export", str(cut), str(tmp_path / "run.csv")]):
        assert main(command) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "cut off after 20 whole messages" in error
        assert "--partial" in error
        assert main([*command, "--partial"]) == 0
        capsys.readouterr()


@pytest.mark.parametrize(
    ("more", "match"),
    [
        (["--episode", "3", "--html", "page.html"], "no episode 3"),
        (["--from", "9", "--to", "10"], "nothing ran"),
    ],
)
def test_bad_requests_are_told_in_one_line(recording, tmp_path, capsys, monkeypatch, more, match):
    monkeypatch.chdir(tmp_path)
    assert main(["show", recording, *more, "--pictures", "pictures"]) == 2
    error = capsys.readouterr().err
    assert match in error
    assert error.count("\n") == 1
    assert not (tmp_path / "pictures").exists()


def test_what_is_no_recording_is_told(tmp_path, capsys):
    assert main(["show", str(tmp_path / "none.mcap")]) == 2
    assert "no such file" in capsys.readouterr().err


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from deepkoco.cli.command_line import main\n"
        "for words in (['show', '--help'], ['export', '--help']):\n"
        "    try: main(words)\n"
        "    except SystemExit as end: assert end.code == 0\n"
        "assert not {'torch', 'pandas', 'numpy', 'rich', 'matplotlib'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for word in ("--pictures", "--html", "--partial", "OUT", "example"):
        assert word in done.stdout
