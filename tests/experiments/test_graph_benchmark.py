"""The benchmarks of the graph go on where they were, and their pages say what their tables hold."""

from pathlib import Path

import pandas as pd
import pytest

from experiments.benchmarks import graph_benchmark
from experiments.benchmarks.supergraph_efficiency_table import answers, summarise

SUPERGRAPHS = Path(graph_benchmark.__file__).parents[2] / "results" / "graph" / "supergraph"
COUNTING = """
import shutil
from pathlib import Path
runs = Path(__file__).with_name("runs")
runs.write_text(runs.read_text() + "I" if runs.exists() else "I")
print("x" * shutil.get_terminal_size().columns)
"""


def test_an_interrupted_benchmark_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "counting.py").write_text(COUNTING)
    asked = {"counts": ("How often", ["counting"]), "fails": ("Never", ["json.tool", "no such file"])}
    monkeypatch.setattr(graph_benchmark, "benchmarks", lambda folder: asked)
    monkeypatch.setattr(graph_benchmark.subprocess, "run", lambda *_, **__: None)  # the peers
    monkeypatch.setattr(graph_benchmark, "as_markdown", lambda: "of nowhere")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    out = tmp_path / "out"
    for _ in range(2):
        assert graph_benchmark.main(["--out", str(out)]) == 1
    assert (tmp_path / "runs").read_text() == "I"
    # A table is as wide as it likes, in the file and on the page.
    assert (out / "counts.txt").read_text() == "x" * graph_benchmark.WIDE + "\n"
    assert sorted(p.name for p in out.iterdir()) == ["BENCHMARK.md", "counts.txt"]
    page = (out / "BENCHMARK.md").read_text()
    assert "x" * graph_benchmark.WIDE in page
    assert "How often" in page
    assert "Never" not in page


def test_the_page_of_supergraphs_says_what_its_cells_hold() -> None:
    rows = pd.read_csv(SUPERGRAPHS / "cells.csv")
    page = (SUPERGRAPHS / "README.md").read_text().splitlines()
    assert [line for line in page if line.startswith("- ")] == answers(rows, summarise(rows))
