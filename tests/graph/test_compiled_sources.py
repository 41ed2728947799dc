"""What numba keeps on disk fits the sources.

It compiles a function again when the file changes that defines it, not when one changes that this calls: after an
update it would run the old code of the latter. So a file names the sources that its compiled functions take
something from, and changes with them.
"""

import ast
import hashlib
import importlib.util
from pathlib import Path

import deepkoco

ROOT = Path(deepkoco.__file__).parent


def test_compiled_functions_change_with_the_sources_that_they_call() -> None:
    checked = 0
    for path in sorted(ROOT.rglob("*.py")):
        text = path.read_text()
        if "numba" not in text:
            continue
        called = sources_called(ast.parse(text))
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
