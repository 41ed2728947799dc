"""What numba keeps on disk fits the sources.

It compiles a function again when the file changes that defines it, not when one changes that this calls: after an
update it would run the old code of the latter. So a file names the sources that its compiled functions take
something from, and changes with them.
"""

import ast
import hashlib
import importlib.util
from pathlib import Path

import pytest

import deepkoco

OTHER_COMPILERS = {
    "cfunc",
    "generated_jit",
    "guvectorize",
    "jit",
    "jitclass",
    "overload",
    "stencil",
    "vectorize",
}
ROOT = Path(deepkoco.__file__).parent


def test_compiled_functions_change_with_the_sources_that_they_call() -> None:
    checked = 0
    for path in sorted(ROOT.rglob("*.py")):
        text = path.read_text()
        if "numba" not in text:
            continue
        tree = ast.parse(text)
        assert unseen(tree) == [], (
            f"{path.relative_to(ROOT.parent)}: what its compiled functions call is not seen"
        )
        called = sources_called(tree)
        if not called:
            continue
        checked += 1
        words = b"".join(source.read_bytes() for source in called)
        line = f'COMPILED_WITH = "{hashlib.sha256(words).hexdigest()[:16]}"'
        names = ", ".join(source.name for source in called)
        assert line in text.splitlines(), (
            f"{path.relative_to(ROOT.parent)} calls {names}; it needs the line {line}"
        )
    assert checked >= 3


@pytest.mark.parametrize(
    "line",
    [
        "import deepkoco.graph.supergraph.embedding as embedding",
        "import deepkoco",
        "from . import embedding",
        "from .embedding import at",
        "from deepkoco import graph",
        "from deepkoco.graph.supergraph import embedding",
        "from numba import jit",
        "from numba import njit, vectorize as v",
        "@jit(nopython=True)\ndef f(x): return x",
        "@numba.vectorize\ndef f(x): return x",
        "@nb.guvectorize([], '()->()')\ndef f(x, y): y[0] = x",
        "f = njit(g)",
        "class A:\n    @njit\n    def f(x): return x",
        "def make():\n    from deepkoco.graph.supergraph.embedding import at\n    return at",
    ],
)
def test_what_would_hide_a_call_is_refused(line: str) -> None:
    assert len(unseen(ast.parse(line))) == 1


def test_what_is_seen_is_not_refused() -> None:
    seen = """
import numpy as np
from numba import njit
from deepkoco.graph.supergraph.embedding import at

@njit(cache=True)
def f(x):
    return at(x)
"""
    tree = ast.parse(seen)
    assert unseen(tree) == []
    assert [path.name for path in sources_called(tree)] == ["embedding.py"]


def unseen(tree: ast.Module) -> list[str]:
    """Lines of a module through which compiled functions may call what `sources_called` does not see."""
    decorated = {
        id(d) for node in tree.body if isinstance(node, ast.FunctionDef) for d in node.decorator_list
    }
    decorating = {id(part) for d in ast.walk(tree) if id(d) in decorated for part in ast.walk(d)}
    lines = set()
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=names):
                hidden = any(name.name.split(".")[0] == "deepkoco" for name in names)
            case ast.ImportFrom(module="numba", names=names):
                hidden = any(name.name in OTHER_COMPILERS or name.asname for name in names)
            case ast.ImportFrom(module=module, level=level):
                ours = (module or "").split(".")[0] == "deepkoco"
                # What a package passes on is defined in another file.
                hidden = level > 0 or (ours and (node not in tree.body or is_package(str(module))))
            case ast.Name(id=name) | ast.Attribute(attr=name):
                hidden = name in OTHER_COMPILERS or (name == "njit" and id(node) not in decorating)
            case _:
                hidden = False
        if hidden:
            lines.add(ast.unparse(node))
    return sorted(lines)


def is_package(module: str) -> bool:
    """Whether a module has others below it."""
    spec = importlib.util.find_spec(module)
    return spec is not None and spec.submodule_search_locations is not None


def sources_called(tree: ast.Module) -> list[Path]:
    """Files of the package that compiled functions of a module take functions or numbers from."""
    homes = {
        name.asname or name.name: node.module
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("deepkoco.")
        for name in node.names
    }
    used = {
        name.id
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and any("njit" in ast.dump(d) for d in node.decorator_list)
        for statement in node.body
        for name in ast.walk(statement)
        if isinstance(name, ast.Name)
    }
    modules = sorted({homes[name] for name in used & set(homes)})
    return [Path(str(importlib.util.find_spec(module).origin)) for module in modules]  # pyright: ignore[reportOptionalMemberAccess]
