"""The examples of the documentation run as they stand."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from deepkoco.agent.stored_controller import StoredController, write_controller
from deepkoco.koopman import KoopmanModel, ModelConfig, export_model
from deepkoco.planning import PlannerConfig

DOCS = Path(__file__).parents[2] / "docs"


def run_examples(page: str, names: dict[str, Any]) -> dict[str, Any]:
    """Run the Python blocks of a page from top to bottom and return the names that there are then."""
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, page, "exec"), names)
    return names


@pytest.fixture(scope="module")
def first_graph(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the page that the others build on defines."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("first_graph"))
        return run_examples("graph.md", {"__name__": "example"})


@pytest.mark.parametrize("page", ["delays.md", "executors.md", "recordings.md", "supergraph.md"])
def test_examples_go_on_from_the_first_graph(
    page: str, first_graph: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run_examples(page, dict(first_graph))


@pytest.mark.parametrize(
    "page",
    [
        "analysis.md",
        "baselines.md",
        "camera.md",
        pytest.param("design.md", marks=pytest.mark.study),
        "distractors.md",
        "environments.md",
        "gradients.md",
        "hidden_cause.md",
        "boxpush.md",
        "landing.md",
        pytest.param("logs.md", marks=pytest.mark.study),
        pytest.param("identify.md", marks=pytest.mark.study),
        "pages.md",
        "planning.md",
        "pool.md",
        "imitation.md",
        "ppo.md",
        "runtimes.md",
        "systems.md",
    ],
)
def test_examples_run_from_top_to_bottom(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if page in ("boxpush.md", "environments.md"):
        pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    run_examples(page, {"__name__": "example"})


def test_the_examples_of_models_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("casadi")
    limit = np.array([2.0])
    torch.manual_seed(0)
    exported = export_model(KoopmanModel(3, 1, ModelConfig(4)))
    stored = StoredController(exported, PlannerConfig(), -limit, limit, {"name": "pendulum"})
    write_controller(stored, tmp_path / "runs" / "first" / "model")
    monkeypatch.chdir(tmp_path)
    run_examples("models.md", {"__name__": "example"})


def test_the_example_of_a_new_cause_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from deepkoco.diagnose import CAUSES
    from deepkoco.systems.effects import EFFECTS

    effects, causes = dict(EFFECTS), dict(CAUSES)
    monkeypatch.chdir(tmp_path)
    try:
        run_examples("diagnose.md", {"__name__": "example"})
    finally:
        for registry, before in ((EFFECTS, effects), (CAUSES, causes)):
            registry.clear()
            registry.update(before)
