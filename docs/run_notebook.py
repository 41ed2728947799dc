"""Run the cells of a notebook without Jupyter, and keep what they print and draw.

``python docs/run_notebook.py docs/own_robot.ipynb`` writes the notebook again with its outputs.
"""

from __future__ import annotations

import base64
import io
import json
import os
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any
from unittest import mock

import matplotlib.pyplot as plt

DPI = 80


def code_cells(notebook: dict[str, Any]) -> list[str]:
    """Sources of the code cells, in their order."""
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run_cells(sources: list[str], folder: Path) -> list[list[dict[str, Any]]]:
    """Run code cells in one namespace and one folder.

    Args:
        sources: The cells.
        folder: Where they read and write their files.

    Returns:
        Outputs of each cell, as a notebook stores them: printed text, then figures.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    before, result = Path.cwd(), []
    os.chdir(folder)
    try:
        for number, source in enumerate(sources, 1):
            printed, drawn = io.StringIO(), []
            with (
                redirect_stdout(printed),
                mock.patch.object(plt, "show", lambda kept=drawn: kept.extend(_figures())),
            ):
                exec(compile(source, f"cell {number}", "exec"), names)
            outputs: list[dict[str, Any]] = []
            if printed.getvalue():
                text = printed.getvalue().replace(str(folder), ".").splitlines(keepends=True)
                outputs.append({"output_type": "stream", "name": "stdout", "text": text})
            for image in drawn:
                shown = {"image/png": image, "text/plain": ["<Figure>"]}
                outputs.append({"output_type": "display_data", "data": shown, "metadata": {}})
            result.append(outputs)
    finally:
        os.chdir(before)
        plt.close("all")
    return result


def _figures() -> list[str]:
    images = []
    for number in plt.get_fignums():
        memory = io.BytesIO()
        plt.figure(number).savefig(memory, format="png", dpi=DPI, metadata={"Software": None})
        images.append(base64.b64encode(memory.getvalue()).decode())
    plt.close("all")
    return images


def main(path: Path) -> None:
    """Run a notebook and write it again with its outputs."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        results = run_cells(code_cells(notebook), Path(folder))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for number, (cell, outputs) in enumerate(zip(cells, results, strict=True), 1):
        cell["outputs"], cell["execution_count"] = outputs, number
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
