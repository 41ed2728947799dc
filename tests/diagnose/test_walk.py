"""The way of a log to its report enters each room once, in the order that the page on the architecture gives."""

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PAGES = {"run": "deepkoco.cli.diagnose", "diagnose": "deepkoco.diagnose.diagnose"}
"""Functions that call the rooms, and their modules; a function of such a module that they call is read in place."""
MOST = 12  # rooms


def _imports(tree: ast.Module) -> dict[str, str]:
    """Modules that names of a module come from, also of imports inside functions."""
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {alias.asname or alias.name: node.module or "" for node in imports for alias in node.names}


class _Way(ast.NodeVisitor):
    """Rooms of the functions that one page calls, in the order of its lines.

    Errors and other ends of the way (an `if` that returns) are left out.
    """

    def __init__(self, module: str) -> None:
        tree = ast.parse(Path(import_module(module).__file__ or "").read_text(encoding="utf-8"))
        self.functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
        self.origin = _imports(tree)
        self.rooms: list[str] = []

    def visit_Raise(self, node: ast.Raise) -> None:
        pass

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> None:
        pass

    def visit_If(self, node: ast.If) -> None:
        if not any(isinstance(inner, ast.Return) for line in node.body for inner in ast.walk(line)):
            self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        for inner in (*node.args, *node.keywords):
            self.visit(inner)
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        module = self.origin.get(name, "")
        if name in self.functions:
            self.generic_visit(self.functions[name])
        elif PAGES.get(name) == module:
            self.rooms += _rooms(name)
        elif module.startswith("deepkoco"):
            self.rooms.append(_room(module))


def _room(module: str) -> str:
    file = Path(import_module(module).__file__ or "")
    return file.parent.relative_to(ROOT / "deepkoco").as_posix()


def _rooms(function: str) -> list[str]:
    way = _Way(PAGES[function])
    way.generic_visit(way.functions[function])
    return way.rooms


def _stops() -> list[str]:
    rooms = _rooms("run")
    return [room for room, before in zip(rooms, ["", *rooms], strict=False) if room != before]


def test_a_log_enters_each_room_on_its_way_to_a_report_once():
    stops = _stops()
    assert len(set(stops)) == len(stops) <= MOST, " > ".join(stops)


def test_the_page_on_the_architecture_gives_the_rooms_of_the_way_in_their_order():
    said = re.search(r"enters these rooms, each once: (.*?)\.\s", PAGE.replace("`--evidence`", ""), re.DOTALL)
    assert said is not None
    assert re.findall(r"`([\w/]+)`", said[1]) == _stops()


@pytest.mark.parametrize("file", sorted(set(re.findall(r"`([a-z_/]+/[a-z_]+\.py)`", PAGE))))
def test_files_that_the_page_on_the_architecture_names_are_there(file):
    assert (ROOT / "deepkoco" / file).is_file() or (ROOT / file).is_file()
