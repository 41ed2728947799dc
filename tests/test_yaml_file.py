"""YAML files of users: whatever they hold is read or refused in one sentence, soon."""

import contextlib
import time

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.logs.recording import LogError
from deepkoco.logs.sidecar import load_sidecar
from deepkoco.systems import ModelFileError, load_model
from deepkoco.unit.unit_file import UnitSpecError, load_unit
from deepkoco.yaml_file import YamlFileError, read_yaml

ALIASES = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 10)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
MERGES = "a: &a {k: 1}\n" + "".join(
    f"{new}: &{new} {{<<: [{', '.join([f'*{old}'] * 10)}]}}\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
HOSTILE = {
    "aliases of aliases": ALIASES,
    "merges of merges": MERGES,
    "alias of itself": "a: &a [*a]",
    "long text repeated": f"a: &a {'x' * 500_000}\nb: [{', '.join(['*a'] * 40_000)}]",
    "nested lists": "system: " + "[" * 100_000,
    "nested lists, closed": "[" * 400 + "]" * 400,
    "nested keys": "\n".join(f"{' ' * i}k:" for i in range(600)),
    "long integer": f"seed: {'9' * 6000}",
    "long hexadecimal integer": f"seed: 0x{'f' * 6000}",
    "long sexagesimal number": f"seed: {'1:' * 3000}1.5",
    "no date": "system: 2024-13-45",
    "wrong tags": "a: !!int ''\nb: !!bool x",
    "a wrong timestamp tag": "a: !!timestamp x",
    "code": "a: !!python/object/apply:os.system [ls]",
    "list as a key": "{[1, 2]: 3}",
    "two documents": "a: 1\n---\nb: 2",
    "too long": "#" * (1 << 20) + "\na: 1",
    "too many entries": "a: [" + "1," * 100_000 + "]",
    "no text": b"\xff\xfe\x00\x01",
    "control characters": "a: \x01",
}
OWNERS = {"unit": (load_unit, UnitSpecError), "model": (load_model, ModelFileError)}


def _write(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_yaml_is_refused_in_one_short_sentence_and_soon(tmp_path, what):
    path = _write(tmp_path / "given.yaml", HOSTILE[what])
    start = time.process_time()
    with pytest.raises(YamlFileError) as told:
        read_yaml(path)
    assert time.process_time() - start < 10.0
    assert str(told.value).startswith(f"{path}: ")
    assert len(str(told.value)) < 600
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_yaml_is_an_error_of_its_owner(tmp_path, what):
    path = _write(tmp_path / "given.yaml", HOSTILE[what])
    for read, error in OWNERS.values():
        with pytest.raises(error, match=r"given\.yaml"):
            read(path)
    with pytest.raises(LogError, match=r"given\.yaml"):
        load_sidecar(tmp_path / "given.csv")


def test_a_folder_and_a_missing_file_are_refused(tmp_path):
    for path in (tmp_path, tmp_path / "none.yaml", "a\0b"):
        with pytest.raises(YamlFileError, match="cannot be read"):
            read_yaml(path)


def test_aliases_and_merges_of_usual_size_are_read(tmp_path):
    path = _write(tmp_path / "a.yaml", "a: &a {x: 1, y: [2, 3]}\nb: *a\nc: {<<: *a, x: 5}\n")
    assert read_yaml(path) == {
        "a": {"x": 1, "y": [2, 3]},
        "b": {"x": 1, "y": [2, 3]},
        "c": {"x": 5, "y": [2, 3]},
    }


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**30), 10**30) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=30,
)


@settings(max_examples=60, deadline=None)
@given(content=PLAIN)
def test_whatever_is_written_is_read_as_the_library_reads_it(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("yaml") / "a.yaml"
    path.write_text(yaml.safe_dump(content, allow_unicode=True), encoding="utf-8")
    assert read_yaml(path) == yaml.safe_load(path.read_bytes())


@settings(max_examples=150, deadline=None)
@given(content=st.text("{}[]:,-&*!|>?#'\"%@ \nab01.xe_~<", max_size=60) | st.binary(max_size=40))
def test_any_text_is_read_or_refused(tmp_path_factory, content):
    path = _write(tmp_path_factory.mktemp("yaml") / "a.yaml", content)
    for read, error in ((read_yaml, YamlFileError), *OWNERS.values()):
        with contextlib.suppress(error):
            read(path)
    with contextlib.suppress(LogError):
        load_sidecar(path.with_suffix(".csv"))
