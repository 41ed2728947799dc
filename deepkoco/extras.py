"""How to get the packages of an extra, for the errors of what needs them."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires

from packaging.requirements import Requirement

DISTRIBUTION = "deepkoco"


def install_command(extra: str) -> str:
    """A command that installs what an extra of pyproject.toml names, wherever deepkoco itself came from.

    No public index holds deepkoco, so that pip finds `deepkoco[EXTRA]` nowhere; the packages it does find.

    Args:
        extra: Name of the extra.
    """
    packages = " ".join(f'"{name}"' for name in dict.fromkeys(_packages(extra)))
    return f"pip install {packages}" if packages else f'pip install -e ".[{extra}]" in the checkout'


def dependency_command(package: str) -> str:
    """A command that installs a package that deepkoco itself depends on, in the version that it asks for.

    Args:
        package: Name of the package.
    """
    try:
        declared = [Requirement(text) for text in requires(DISTRIBUTION) or ()]
    except PackageNotFoundError:
        declared = []
    version = next((str(r.specifier) for r in declared if r.name == package and r.marker is None), "")
    return f'pip install "{package}{version}"'


def _packages(extra: str) -> Iterator[str]:
    """The requirements of an extra, those of extras that it names among them."""
    try:
        declared = [Requirement(text) for text in requires(DISTRIBUTION) or ()]
    except PackageNotFoundError:
        return
    for requirement in declared:
        marker = requirement.marker
        if marker is None or marker.evaluate({"extra": ""}) or not marker.evaluate({"extra": extra}):
            continue
        if requirement.name == DISTRIBUTION:
            for inner in sorted(requirement.extras):
                yield from _packages(inner)
        else:
            extras = f"[{','.join(sorted(requirement.extras))}]" if requirement.extras else ""
            yield f"{requirement.name}{extras}{requirement.specifier}"
