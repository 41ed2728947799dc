"""The page "My own robot": its files are the examples, its Python runs, its commands run as they stand."""

import re
import shlex
import sys
from pathlib import Path

import pytest

from deepkoco.cli.command_line import main
from tests.oracle.own_robots import CartPoleUnit

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "own_robot.md").read_text(encoding="utf-8")
ARM = """<mujoco><worldbody><body name="arm"><joint name="shoulder" type="hinge" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02" mass="1"/></body></worldbody>
<actuator><motor name="drive" joint="shoulder" ctrlrange="-3 3"/></actuator></mujoco>"""
SMALL = ["agent.model.encoder_hidden=[16]", "agent.model.cost_hidden=[16]", "agent.first_episodes=6",
         "agent.first_epochs=2", "agent.iteration_episodes=2", "agent.total_episodes=8",
         "agent.evaluation_episodes=2", "agent.final_evaluation_episodes=3"]  # fmt: skip


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def commands() -> list[list[str]]:
    return [shlex.split(line)[1:] for block in blocks("console") for line in block.splitlines() if line]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the page's own files, an MJCF, and the log of a cart whose commands act 30 ms late."""
    for block in blocks("python"):
        if name := re.match(r"# (\w+\.py)\n", block):
            (tmp_path / name[1]).write_text(block)
    (tmp_path / "arm.xml").write_text(ARM)
    CartPoleUnit(delay=0.03).log(tmp_path, "cart", seconds=20.0).with_suffix(".yaml").unlink()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    return tmp_path


def test_the_class_of_the_page_is_the_example():
    block = next(b for b in blocks("python") if b.startswith("# my_robot.py"))
    example = (DOCS / "examples" / "cart_pole.py").read_text()
    assert block.split("class CartPole")[1] == example.split("class CartPole")[1]


def test_the_python_of_the_page_runs(here: Path):
    for block in blocks("python"):
        exec(compile(block, "own_robot.md", "exec"), {"__name__": "example"})


def test_the_quick_commands_of_the_page_run(here: Path, capsys):
    pytest.importorskip("mujoco")
    ran = [words for words in commands() if words[0] in ("systems", "inspect")]
    for words in ran:
        assert main(words) == 0, words
    assert len(ran) == 3
    assert (here / "cart.yaml").is_file()
    assert "cart_mass" in capsys.readouterr().out


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_the_commands_of_the_page_lead_from_the_log_to_a_controller(here: Path, capsys):
    pytest.importorskip("mujoco")
    for words in commands():
        assert main([*words, *(SMALL if words[0] == "train" else [])]) == 0, words
    said = capsys.readouterr().out
    assert "actuation delay (cart)" in said
    assert "runs/swing: cost" in said
