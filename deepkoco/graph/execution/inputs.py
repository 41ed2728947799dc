"""Inputs of the supervisor that are gathered only when they are looked at."""

from collections.abc import Callable, Iterator, Mapping

from deepkoco.graph.model.node import Input


class LazyInputs(Mapping[str, Input]):
    """What the supervisor sees, gathered when it is looked at.

    Args:
        names: of its inputs.
        collect: gathers all of them.
    """

    __slots__ = ("_collect", "_found", "_names")

    def __init__(self, names: tuple[str, ...], collect: Callable[[], Mapping[str, Input]]) -> None:
        self._names, self._collect = names, collect
        self._found: Mapping[str, Input] | None = None

    def __getitem__(self, name: str) -> Input:
        if name not in self._names:
            raise KeyError(name)
        if self._found is None:
            self._found = self._collect()
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)
