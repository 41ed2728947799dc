"""Every study and benchmark starts, and says what it takes."""

import runpy
import sys
import warnings
from pathlib import Path

import pytest

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
# Scripts of the environments of other packages, and one that prints the versions in use.
OTHERS = ("experiments.benchmarks.peers", "experiments.plumbing")


def programs() -> list[str]:
    """Modules of experiments that are run."""
    files = [p for p in sorted(EXPERIMENTS.rglob("*.py")) if "__name__ ==" in p.read_text(encoding="utf-8")]
    names = [".".join(p.relative_to(EXPERIMENTS.parent).with_suffix("").parts) for p in files]
    return [n.removesuffix(".__main__") for n in names if not n.startswith(OTHERS)]


def test_all_kinds_of_programs_are_found():
    assert {"experiments.demo", "experiments.studies.graph.real_delays", "experiments.train"} <= set(
        programs()
    )


@pytest.mark.parametrize("name", programs())
def test_a_program_says_what_it_takes(name: str, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(SystemExit) as end:
            runpy.run_module(name, run_name="__main__")
    assert not end.value.code
    said = capsys.readouterr().out
    assert "usage:" in said or "Hydra" in said
