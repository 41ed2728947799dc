"""YAML files that users give: read with a bound on their size, whatever they hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

LARGEST_FILE = 1 << 20  # bytes
MOST_ENTRIES = 30_000
"""Keys, values and lists of a file; what an alias repeats counts each time, 1,000 characters of a text as one."""
DEEPEST_NESTING = 50
LONGEST_NUMBER = 100  # characters; whatever is shorter fits into a float


class YamlFileError(ValueError):
    """A file cannot be read as YAML; the message names it and says what is wrong."""


class _Loader(yaml.SafeLoader):
    """Refuses content that would take unbounded time, memory or recursion."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0
        self._sizes: dict[int, int] = {}
        self._entries = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        alias = self.check_event(yaml.AliasEvent)
        mark = self.peek_event().start_mark
        self._depth += 1
        if self._depth > DEEPEST_NESTING:
            raise _refusal(f"is nested more than {DEEPEST_NESTING} deep", mark)
        before = self._entries
        self._entries += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        if isinstance(node, yaml.ScalarNode):
            self._entries += len(node.value) // 1000
            number = node.tag in ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
            if number and len(node.value) > LONGEST_NUMBER:
                raise _refusal(f"has a number of {len(node.value)} characters", mark)
        if alias:
            size = self._sizes.get(id(node))
            if size is None:
                raise _refusal("has an alias inside of what the alias stands for", mark)
            self._entries += size
        else:
            # The loader keeps every node that has a name, so that these numbers stay theirs.
            self._sizes[id(node)] = self._entries - before
        if self._entries > MOST_ENTRIES:
            raise _refusal(f"has more than {MOST_ENTRIES} entries, those repeated by aliases included", mark)
        return node


def read_yaml(path: str | Path) -> Any:
    """Read the one document of a YAML file in plain values, as `yaml.safe_load` does.

    Args:
        path: File in UTF-8.

    Returns:
        What it holds; None for an empty file.

    Raises:
        YamlFileError: The file cannot be read, is no YAML, or has more than `LARGEST_FILE` bytes, `MOST_ENTRIES`
            entries or `DEEPEST_NESTING` levels.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:  # a name with a null byte is a ValueError
        raise YamlFileError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(content) > LARGEST_FILE:
        raise YamlFileError(f"{path}: has more than {LARGEST_FILE} bytes; this is no file that people write")
    try:
        loader = _Loader(content.decode("utf-8"))
        return loader.get_single_data()
    # The library raises errors of many kinds on wrong numbers, dates and tags: ValueError, KeyError, AttributeError.
    except Exception as error:
        raise YamlFileError(f"{path}: is not YAML: {' '.join(str(error).split())[:300]}") from error


def shown(value: Any, most: int = 200) -> str:
    """Write a value for an error message, cut off where it is long."""
    text = repr(value)
    return text if len(text) <= most else f"{text[:most]}..."


def _refusal(text: str, mark: yaml.Mark) -> yaml.YAMLError:
    return yaml.YAMLError(f"it {text} (line {mark.line + 1}, column {mark.column + 1})")
