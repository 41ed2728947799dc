"""The stages of a diagnosis hand their results forward: no stage reaches a later one."""

import ast
from pathlib import Path

import pytest

import deepkoco

ROOT = Path(deepkoco.__file__).parents[1]
STAGES = (
    "deepkoco.diagnose.data",
    "deepkoco.diagnose.request",
    "deepkoco.diagnose.baseline",
    "deepkoco.diagnose.baseline_refit",
    "deepkoco.diagnose.refitted",
    "deepkoco.diagnose.explanation",
    "deepkoco.diagnose.weighed",
    "deepkoco.diagnose.longer_windows",
    "deepkoco.diagnose.verdict.judgement",
    "deepkoco.diagnose.verdict.result",
    "deepkoco.diagnose.diagnose",
)


def _file(module: str) -> Path | None:
    path = ROOT / Path(*module.split("."))
    found = (path.with_suffix(".py"), path / "__init__.py")
    return next((f for f in found if f.is_file()), None)


def _imported(module: str) -> set[str]:
    """Return the modules of the diagnosis that a module names in its imports, also those inside functions."""
    found = set()
    for node in ast.walk(ast.parse(_file(module).read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("deepkoco.diagnose"):
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {m for m in (node.module, *inside) if _file(m) is not None}
    return found


def _reached(module: str) -> set[str]:
    reached, waiting = set(), {module}
    while waiting:
        new = _imported(waiting.pop()) - reached
        reached |= new
        waiting |= new
    return reached


@pytest.mark.parametrize("stage", range(len(STAGES)), ids=lambda k: STAGES[k].rsplit(".", 1)[-1])
def test_a_stage_reaches_no_later_stage(stage):
    assert _reached(STAGES[stage]).isdisjoint(STAGES[stage + 1 :])


def test_the_page_reaches_every_stage():
    assert _reached(STAGES[-1]) >= set(STAGES[:-1])
