"""What errors say to install: packages that pip finds, wherever deepkoco came from."""

import tomllib
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from deepkoco import extras

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]


@pytest.fixture
def declared(monkeypatch):
    """The metadata that this checkout would be installed with, whatever is installed now."""
    lines = [*PROJECT["dependencies"]]
    for name, requirements in EXTRAS.items():
        lines += [f'{requirement}; extra == "{name}"' for requirement in requirements]
    monkeypatch.setattr(extras, "requires", lambda name: lines)


@pytest.mark.usefixtures("declared")
@pytest.mark.parametrize("extra", sorted(name for name in EXTRAS if EXTRAS[name]))
def test_every_extra_is_told_as_packages_with_their_versions(extra):
    command = extras.install_command(extra)
    packages = [Requirement(text) for text in command.removeprefix("pip install ").strip('"').split('" "')]
    own = {Requirement(text).name for text in EXTRAS[extra]} - {"deepkoco"}
    assert own <= {package.name for package in packages}
    assert "deepkoco" not in {package.name for package in packages}
    assert not {package.name for package in packages} & {Requirement(t).name for t in PROJECT["dependencies"]}


@pytest.mark.usefixtures("declared")
def test_extras_named_by_an_extra_are_told_too():
    assert "dm_control==" in extras.install_command("dev")


def test_without_metadata_the_extra_of_a_checkout_is_told(monkeypatch):
    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(extras, "requires", missing)
    assert extras.install_command("ros") == 'pip install -e ".[ros]" in the checkout'
