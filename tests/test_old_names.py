"""Modules and names that have moved."""

import importlib
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from deepkoco.old_names import MOVED, MOVED_NAMES, moved_modules

ROOT = Path(__file__).parents[1]
TABLE = moved_modules(MOVED)


pytestmark = pytest.mark.filterwarnings("ignore:.* has moved to deepkoco:DeprecationWarning")


def test_every_moved_module_has_a_new_place() -> None:
    for old, new in TABLE.items():
        assert importlib.util.find_spec(new) is not None, f"{old}: there is no {new}"


@pytest.mark.parametrize(
    "old",
    ["deepkoco.identify.trial", "deepkoco.graph.units", "deepkoco.graph.storage.read"],
)
def test_a_moved_module_is_the_module_at_the_new_place(old: str) -> None:
    sys.modules.pop(old, None)
    with pytest.warns(DeprecationWarning, match=f"{old} has moved to deepkoco"):
        module = importlib.import_module(old)
    assert module.__name__ != old
    assert module is importlib.import_module(module.__name__)
    assert module.__spec__.name == module.__name__


@pytest.mark.parametrize(("package", "name"), MOVED_NAMES)
def test_a_moved_name_is_the_object_at_the_new_place(package: str, name: str) -> None:
    home = MOVED_NAMES[package, name]
    with pytest.warns(DeprecationWarning, match=f"{package}.{name} has moved to {home}.{name}"):
        found = getattr(importlib.import_module(package), name)
    assert found is getattr(importlib.import_module(home), name)


@pytest.mark.parametrize("name", ["episode_table", "export_episodes"])
def test_names_of_the_old_storage_package_are_still_there(name: str) -> None:
    old = importlib.import_module("deepkoco.graph.storage")
    assert getattr(old, name) is getattr(importlib.import_module("deepkoco.graph.episodes.export"), name)


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("deepkoco.diagnose", "diagnose"),
        ("deepkoco.diagnose.report", "write_report"),
        ("deepkoco.diagnose.healthy", "learn_baseline"),
        ("deepkoco.graph.timing", "draw_timing"),
        ("deepkoco.koopman.lifting", "Identity"),
        ("deepkoco.koopman.model", "KoopmanModel"),
        ("deepkoco.cli", "main"),
        ("deepkoco.cli", "build_parser"),
        ("deepkoco.analysis.page", "write_page"),
        ("deepkoco.diagnose.residuals", "missing_torque"),
    ],
)
def test_names_of_modules_that_became_packages_are_still_there(module: str, name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert callable(getattr(importlib.import_module(module), name))


def test_a_name_that_never_was_is_not_found() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"deepkoco\.identity"):
        importlib.import_module("deepkoco.identity")
    with pytest.raises(AttributeError, match="cameras"):
        importlib.import_module("deepkoco.graph").cameras  # noqa: B018
    with pytest.raises(AttributeError, match="sentence"):
        importlib.import_module("deepkoco.diagnose.verdict").sentence  # noqa: B018


def test_a_module_runs_under_its_old_name() -> None:
    program = [sys.executable, "-W", "ignore", "-m", "deepkoco.unit.systems_command"]
    assert subprocess.run(program, check=False, capture_output=True, text=True).returncode == 0


@pytest.mark.parametrize("name", ["units", "realtime", "recording", "cuda", "log_files"])
def test_modules_of_the_graph_are_attributes_by_their_old_names(name: str) -> None:
    found = getattr(importlib.import_module("deepkoco.graph"), name)
    assert found is importlib.import_module(f"deepkoco.graph.{name}")


def test_a_moved_package_gives_the_names_of_the_new_one_after_its_modules_are_imported() -> None:
    # In a process of its own: an import binds a module to its package once.
    program = """
import deepkoco.identify.fit
import deepkoco.identify as old
import deepkoco.fit as new
assert old.fit is new.fit and callable(new.fit), (old.fit, new.fit)
assert old.__all__ == new.__all__
from deepkoco.identify.fit import FitProblem
assert FitProblem is new.FitProblem
old.marked = 3
assert new.marked == 3
"""
    run = [sys.executable, "-W", "ignore", "-c", program]
    done = subprocess.run(run, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("old", ["closing_the_loop", pytest.param("hidden_effects", marks=pytest.mark.study)])
def test_a_recorded_command_runs_under_its_old_name(old: str) -> None:
    program = [sys.executable, "-W", "ignore", "-m", f"experiments.{old}", "--help"]
    done = subprocess.run(program, check=False, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("usage:")
