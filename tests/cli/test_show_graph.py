"""`deepkoco show` of a file with a graph."""

import json
from pathlib import Path

import pytest

from deepkoco.cli import main
from deepkoco.graph.net.graph_file import node_from, read_graph_file

EXAMPLE = str(Path(__file__).parents[2] / "docs/examples/two_machines.py")


@pytest.fixture
def setup(tmp_path):
    path = tmp_path / "setup.yaml"
    path.write_text("nodes: {world: {delay: 0.003}}\nparameters: {world: {mass: 0.7}}\n")
    return path


def test_rates_delays_and_windows_are_printed_and_a_page_is_written(tmp_path, setup, capsys):
    page = tmp_path / "pages" / "graph.html"
    assert (
        main(["show", EXAMPLE, "--setup", str(setup), "--html", str(page), "--pictures", str(tmp_path / "p")])
        == 0
    )
    printed = capsys.readouterr().out
    assert "agent->world" in printed
    assert "for the next step (skip)" in printed
    assert "3 ms" in printed
    assert "0.7" in page.read_text()
    assert any((tmp_path / "p").glob("*.png"))
    assert main(["show", EXAMPLE, "--html", str(page)]) == 2
    assert "exists" in capsys.readouterr().err


def test_json_is_the_setup(setup, capsys):
    assert main(["show", EXAMPLE, "--setup", str(setup), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["nodes"]["world"]["delay"] == 0.003
    assert shown["parameters"]["world"]["mass"] == 0.7


def test_processes_of_their_own_make_nodes_with_the_setup(setup):
    file = read_graph_file(EXAMPLE, setup)
    assert file.factories({"world"})["world"]().delay.mean == 0.003
    assert node_from(EXAMPLE, "world").delay.mean == 0.0
    assert file.parameters()["world"]["mass"] == 0.7


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--episode", "1"], "--episode belongs to recordings"),
        (["--task", "X-v0"], "--task belongs to training runs"),
        (["--setup", "none.yaml"], "none.yaml: cannot be read"),
    ],
)
def test_what_does_not_belong_to_a_graph_is_refused(arguments, says, capsys):
    assert main(["show", EXAMPLE, *arguments]) == 2
    assert says in capsys.readouterr().err


def test_a_setup_that_does_not_fit_is_named_with_its_file(tmp_path, capsys):
    path = tmp_path / "wrong.yaml"
    for text, says in (
        ("nodes: {wold: {rate: 1}}", "did you mean world"),
        ("parameters: {world: {mas: 1}}", "did you mean mass"),
    ):
        path.write_text(text)
        assert main(["show", EXAMPLE, "--setup", str(path)]) == 2
        told = capsys.readouterr().err
        assert f"{path}: " in told
        assert says in told
    recording = tmp_path / "run.mcap"
    recording.write_bytes(b"")
    assert main(["show", str(recording), "--setup", str(path)]) == 2
    assert "--setup belongs to files of a graph" in capsys.readouterr().err
