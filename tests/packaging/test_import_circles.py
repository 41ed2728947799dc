"""No module imports, in any way, what imports it: at the top, in a function, or for types alone."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import deepkoco

ROOT = Path(deepkoco.__file__).parent.parent


def imports(sources: dict[str, str]) -> dict[str, set[str]]:
    """Module -> modules among the given ones that it imports."""
    found: dict[str, set[str]] = {}
    for module, text in sources.items():
        named = set()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module:
                full = [f"{node.module}.{a.name}" for a in node.names]
                named |= {name if name in sources else node.module for name in full}
            elif isinstance(node, ast.Import):
                named |= {a.name for a in node.names}
        found[module] = (named & set(sources)) - {module}
    return found


def circle(sources: dict[str, str]) -> list[str]:
    """Modules of one circle, from a module back to it; empty if there is none."""
    try:
        TopologicalSorter(imports(sources)).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_modules_of_the_package_import_each_other_in_no_circle() -> None:
    sources = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path.read_text()
        for path in (ROOT / "deepkoco").rglob("*.py")
    }
    assert len(sources) > 500
    assert circle(sources) == []


@pytest.mark.parametrize(
    "back",
    [
        "import a",
        "from a import f",
        "def g():\n    from a import f",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from a import f",
    ],
)
def test_a_circle_is_found_wherever_the_import_stands(back: str) -> None:
    assert set(circle({"a": "from b import g", "b": back})) == {"a", "b"}


def test_imports_in_one_direction_are_no_circle() -> None:
    assert circle({"a": "from b import g", "b": "import c", "c": "import math"}) == []
