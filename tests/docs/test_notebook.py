"""The notebook "My own robot": its cells run from the log to the controller, and it shows what they print."""

import importlib.util
import json
import re
import sys
from pathlib import Path

import matplotlib as mpl
import pytest

DOCS = Path(__file__).parents[2] / "docs"
NOTEBOOK = json.loads((DOCS / "own_robot.ipynb").read_text(encoding="utf-8"))
LEAST = {"first_episodes": 6, "first_epochs": 2, "iteration_episodes": 2, "total_episodes": 8,
         "evaluation_episodes": 2, "final_evaluation_episodes": 2}  # fmt: skip


@pytest.fixture
def runner(monkeypatch: pytest.MonkeyPatch):
    spec = importlib.util.spec_from_file_location("run_notebook", DOCS / "run_notebook.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(sys, "path", [*sys.path])
    mpl.use("Agg")
    return module


def smaller(source: str) -> str:
    """A cell with a shorter log, or with the least training that has every step of one."""
    source = source.replace("range(1200)", "range(700)")
    for name, count in LEAST.items():
        source = re.sub(rf"agent\.{name}=\d+", f"agent.{name}={count}", source)
    return source


@pytest.mark.study
@pytest.mark.timeout(300)
def test_the_cells_of_the_notebook_run_from_the_log_to_a_controller(runner, tmp_path):
    sources = [smaller(source) for source in runner.code_cells(NOTEBOOK)]
    outputs = runner.run_cells(sources, tmp_path)
    said = "".join("".join(part.get("text", ())) for cell in outputs for part in cell)
    found = re.search(r"cause: coulomb\.torque = ([\d.]+)", said)
    assert found is not None
    assert abs(float(found[1]) - 0.25) < 0.02
    assert "runs/hold: noise-free cost" in said
    assert sum("data" in part for cell in outputs for part in cell) == 2
    assert (tmp_path / "report" / "robot_extended.xml").is_file()


def test_the_notebook_is_stored_with_outputs_of_its_cells():
    cells = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    said = "".join("".join(part.get("text", ())) for cell in cells for part in cell["outputs"])
    assert "coulomb.torque" in said
    assert "/tmp/" not in json.dumps(NOTEBOOK)
    assert len(json.dumps(NOTEBOOK)) < 200_000


def test_figures_and_text_of_a_cell_become_its_outputs(runner, tmp_path):
    drawing = "import matplotlib.pyplot as plt\nplt.figure(figsize=(1, 1)); print('one', kept); plt.show()"
    first, second = runner.run_cells(["kept = 3", drawing], tmp_path)
    assert first == []
    assert second[0]["text"] == ["one 3\n"]
    assert second[1]["data"]["image/png"].startswith("iVBOR")
