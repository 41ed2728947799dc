"""Systems outside of the package: found by file, module, entry point and model.yaml, with words for what is missing."""

import os
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
import yaml

import deepkoco
from deepkoco import own_objects
from deepkoco.systems import (
    SYSTEMS,
    ExtendedSystem,
    ModelFileError,
    System,
    SystemLoadError,
    TakenNameError,
    UnknownSystemError,
    load_model,
    load_system,
    register_system,
    save_model,
    system_names,
)

ROBOT = """
import numpy as np
import torch
from deepkoco.systems import Channel, Parameter, System


class Slider(System):
    name = "slider"
    joints = 1
    state_names, state_units = ("place", "speed"), ("m", "m/s")
    load_scale = 5.0
    parameters = (Parameter("mass", 2.0, "kg", 0.1, 10.0, 0.5, "m"),)
    commands = (Channel("force", "N", "command", -5.0, 5.0),)
    measurements = (
        Channel("place", "m", "measurement", noise_sd=1e-3),
        Channel("speed", "m/s", "measurement", noise_sd=0.1),
    )

    def effort_of(self, commands):
        return commands[..., 0]

    def accelerations(self, parameters):
        def law(motion):
            load = 0.0 if motion.loads is None or motion.loads[0] is None else motion.loads[0]
            return ((motion.efforts[0] + load) / parameters["mass"],)
        return law

    def derivative(self, state, effort, parameters):
        return torch.stack([state[..., 1], effort / parameters["mass"]], -1)

    def with_payload(self, mass, parameters):
        return {**parameters, "mass": parameters["mass"] + mass}

    def draw_on(self, image, measurement, command=None):
        pass
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a robot of the user's own, which is the current one."""
    (tmp_path / "my_slider.py").write_text(ROBOT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    return tmp_path


@pytest.mark.parametrize("text", ["my_slider.py:Slider", "my_slider.py", "my_slider:Slider"])
def test_load_system_finds_the_class_of_a_file_or_a_module(folder: Path, text: str):
    system = load_system(text)
    assert (system.name, type(system).__name__) == ("slider", "Slider")
    assert isinstance(system, System)
    again = load_system(str(system.origin))
    assert type(again).__name__ == "Slider"


def test_load_system_takes_names_classes_and_systems(folder: Path):
    found = load_system("my_slider.py")
    assert load_system(found) is found
    assert load_system(type(found)).origin == f"{folder / 'my_slider.py'}:Slider"
    assert load_system("pendulum").origin is None
    assert deepkoco.load_system("pendulum").name == "pendulum"


def test_load_system_reads_a_file_again_after_it_was_changed(folder: Path):
    assert load_system("my_slider.py").parameter("mass").value == 2.0
    (folder / "my_slider.py").write_text(ROBOT.replace('"mass", 2.0', '"mass", 3.25'))
    assert load_system("my_slider.py").parameter("mass").value == 3.25


def test_model_file_finds_its_system_from_its_own_folder_wherever_one_stands(
    folder: Path, monkeypatch: pytest.MonkeyPatch
):
    (folder / "report").mkdir()
    model = folder / "report" / "model.yaml"
    save_model(
        model, ExtendedSystem(load_system("my_slider.py:Slider"), ("coulomb",), {"coulomb.torque": 0.7})
    )
    assert yaml.safe_load(model.read_text())["origin"] == "../my_slider.py:Slider"
    moved = folder / "moved"
    moved.mkdir()
    (folder / "report").rename(moved / "report")
    (folder / "my_slider.py").rename(moved / "my_slider.py")
    monkeypatch.chdir(moved / "report")
    for path in ("model.yaml", str(moved / "report" / "model.yaml")):
        system = load_system(path)
        assert isinstance(system, ExtendedSystem)
        assert system.parameter("coulomb.torque").value == 0.7
        assert system.origin == f"{moved / 'my_slider.py'}:Slider"


def test_model_file_finds_its_system_in_the_current_folder_or_beside_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
):
    (folder / "report").mkdir()
    save_model(folder / "report" / "model.yaml", load_system("my_slider.py:Slider"))
    for place in ("elsewhere", "report"):
        (folder / place).mkdir(exist_ok=True)
        next(folder.rglob("my_slider.py")).rename(folder / place / "my_slider.py")
        monkeypatch.chdir(folder / "elsewhere")
        assert load_model(folder / "report" / "model.yaml").base.name == "slider"


def test_model_file_whose_system_is_gone_names_the_file(folder: Path):
    save_model(folder / "model.yaml", load_system("my_slider.py:Slider"))
    (folder / "my_slider.py").unlink()
    with pytest.raises(ModelFileError, match=r"model\.yaml: .*there is no file my_slider\.py"):
        load_model("model.yaml")


def test_model_file_without_an_origin_reads_a_name_of_the_package(tmp_path: Path):
    save_model(tmp_path / "model.yaml", load_system("pendulum"))
    assert "origin" not in yaml.safe_load((tmp_path / "model.yaml").read_text())
    assert load_model(tmp_path / "model.yaml").base.name == "pendulum"


def test_model_file_of_a_class_made_in_a_function_needs_its_name_registered(
    folder: Path, monkeypatch: pytest.MonkeyPatch
):
    class Here(type(load_system("my_slider.py"))):
        name = "here"

    save_model(folder / "model.yaml", Here())
    with pytest.raises(ModelFileError, match="register_system"):
        load_model("model.yaml")
    monkeypatch.setattr("deepkoco.systems.registry.SYSTEMS", SYSTEMS)
    try:
        register_system(Here)
        assert isinstance(load_model("model.yaml").base, Here)
        assert "here" in system_names()
        with pytest.raises(TakenNameError, match="here"):
            register_system(type(load_system("my_slider.py")), "here")
    finally:
        SYSTEMS.pop("here")


def test_load_system_finds_what_an_installed_package_declares(folder: Path, monkeypatch: pytest.MonkeyPatch):
    point = EntryPoint("cart_of_a_package", "my_slider:Slider", "deepkoco.systems")
    broken = EntryPoint("broken", "no_such_module:Slider", "deepkoco.systems")
    monkeypatch.syspath_prepend(str(folder))

    def declared(group: str, name: str | None = None):
        points = {"deepkoco.systems": [point, broken]}.get(group, [])
        return [p for p in points if name in (None, p.name)]

    monkeypatch.setattr(own_objects, "entry_points", declared)
    assert load_system("cart_of_a_package").name == "slider"
    assert "cart_of_a_package" in system_names()
    with pytest.raises(UnknownSystemError, match="no_such_module"):
        load_system("broken")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("my_slidr.py:Slider", r"no file my_slidr\.py, in .*; give its path"),
        ("my_slider.py:Slidr", r"has no Slidr; did you mean Slider\?"),
        ("my_slider.py:ROBOT", r"has no ROBOT; it defines Slider"),
        ("my_slider.py:np", r"np is no System: derive the class from deepkoco\.System"),
        ("no_such_module_at_all:Slider", "there is no module no_such_module_at_all"),
        ("broken.py:A", r"importing .*broken\.py, line 2, failed: ZeroDivisionError"),
        ("two.py", r"two\.py defines A, B; give the class behind a colon"),
        ("needy.py", r"Needy\(\) failed: TypeError.*made without arguments"),
        ("robot.stl", "is no system; give a name, my_robot"),
        ("arm.xml", r"there is no file arm\.xml"),
        ("pendulm", "did you mean pendulum"),
    ],
)
def test_load_system_says_what_to_change(folder: Path, text: str, said: str):
    (folder / "broken.py").write_text("\n1 / 0\n")
    (folder / "two.py").write_text(
        "from my_slider import Slider\nclass A(Slider): pass\nclass B(Slider): pass\n"
    )
    needy = "from my_slider import Slider\nclass Needy(Slider):\n    def __init__(self, mass): pass\n"
    (folder / "needy.py").write_text(needy)
    with pytest.raises(UnknownSystemError, match=said) as caught:
        load_system(text)
    assert "\n" not in str(caught.value)
    if text != "pendulm":
        assert isinstance(caught.value, SystemLoadError)


def test_a_file_never_hides_an_installed_module(folder: Path):
    (folder / "yaml.py").write_text(ROBOT)
    assert load_system("yaml.py:Slider").name == "slider"
    import yaml as installed

    assert installed is yaml
    assert os.path.dirname(yaml.__file__) != str(folder)
