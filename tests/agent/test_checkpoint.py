"""Checkpoints and seeds."""

import os
import pickle
import resource
import zipfile
from pathlib import Path

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepkoco.agent.checkpoint import CheckpointError, check_settings, load_checkpoint, save_checkpoint
from deepkoco.agent.replay_files import read_replay
from deepkoco.agent.seeding import Purpose, derive_seed


def test_a_checkpoint_restores_tensors_values_and_generators(tmp_path):
    generator = torch.Generator().manual_seed(1)
    torch.randn(3, generator=generator)
    path = tmp_path / "c.pt"
    save_checkpoint(path, {"w": torch.arange(3), "n": 4, "rng": generator.get_state()})
    expected = torch.randn(3, generator=generator)
    state = load_checkpoint(path)
    other = torch.Generator()
    other.set_state(state["rng"])
    assert torch.equal(torch.randn(3, generator=other), expected)
    assert torch.equal(state["w"], torch.arange(3))
    assert state["n"] == 4
    assert [p.name for p in tmp_path.iterdir()] == ["c.pt"]


def test_an_interrupted_write_leaves_the_old_checkpoint(tmp_path):
    path = tmp_path / "c.pt"
    save_checkpoint(path, {"n": 1})
    with pytest.raises(Exception, match="pickle"):
        save_checkpoint(path, {"n": (i for i in range(3))})
    assert load_checkpoint(path)["n"] == 1


def test_a_missing_checkpoint_is_named(tmp_path):
    with pytest.raises(CheckpointError, match="no checkpoint"):
        load_checkpoint(tmp_path / "c.pt")


STATE = {"w": torch.arange(40, dtype=torch.float32), "n": 4, "rows": [{"a": 1.5}], "name": "x"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("checkpoint") / "c.pt"
    save_checkpoint(path, STATE)
    return path, path.read_bytes()


def check_damage(path, bytes_):
    """A damaged checkpoint is refused in one sentence, or holds what was saved."""
    path.write_bytes(bytes_)
    try:
        state = load_checkpoint(path)
    except CheckpointError as error:
        assert str(path) in str(error)  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017
        return
    assert torch.equal(state.pop("w"), STATE["w"])
    assert state == {name: value for name, value in STATE.items() if name != "w"}


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.integers(0), bit=st.integers(0, 7))
def test_every_flipped_bit_of_a_checkpoint_is_found(place, bit, whole):
    path, original = whole
    flipped = bytearray(original)
    flipped[place % len(flipped)] ^= 1 << bit
    check_damage(path, bytes(flipped))


@settings(max_examples=100, deadline=None)
@given(place=st.integers(0))
def test_every_truncation_of_a_checkpoint_is_found(place, whole):
    path, original = whole
    path.write_bytes(original[: place % len(original)])
    with pytest.raises(CheckpointError, match="damaged"):
        load_checkpoint(path)


class _Runs:
    def __reduce__(self):
        return os.system, ("touch /tmp/deepkoco_checkpoint_ran_code",)


@pytest.mark.parametrize(
    "content", [b"", b"x" * 100, pickle.dumps({"version": 2, "x": _Runs()}), pickle.dumps([1])]
)
def test_foreign_files_are_refused_and_never_run(content, tmp_path):
    (tmp_path / "c.pt").write_bytes(content)
    with pytest.raises(CheckpointError, match="damaged"):
        load_checkpoint(tmp_path / "c.pt")
    assert not Path("/tmp/deepkoco_checkpoint_ran_code").exists()


@pytest.mark.parametrize(
    "content", [{"actions": [], "costs": []}, {"observations": [torch.zeros(2)], "actions": [], "costs": []}]
)
def test_a_replay_file_that_holds_no_episodes_is_named(content, tmp_path):
    (tmp_path / "replay").mkdir()
    save_checkpoint(tmp_path / "replay" / "000.pt", content)
    with pytest.raises(CheckpointError, match=r"000\.pt: damaged"):
        read_replay(tmp_path, 1)


def test_evaluation_never_uses_a_training_seed():
    training = {derive_seed(s, p, i) for s in range(20) for p in list(Purpose)[:4] for i in range(20)}
    evaluation = {derive_seed(s, p, i) for s in range(20) for p in list(Purpose)[4:] for i in range(20)}
    assert max(training) + 2**20 < 2**30 <= min(evaluation)
    assert max(evaluation) + 2**20 < 2**31
    assert len(training) == 20 * 4 * 20


def test_a_checkpoint_of_other_settings_is_refused_by_name(tmp_path):
    config = {"horizon": 15, "model": {"encoder_hidden": (8, 8)}}
    state = {"seed": 3, "config": config}
    path = tmp_path / "c.pt"
    check_settings(path, state, {"horizon": 15, "model": {"encoder_hidden": [8, 8]}}, 3)
    with pytest.raises(CheckpointError, match="made with seed = 3 instead of 4;"):
        check_settings(path, state, config, 4)
    with pytest.raises(CheckpointError, match=r"model\.encoder_hidden = \[8, 8\] instead of \[8\];"):
        check_settings(path, state, {"horizon": 15, "model": {"encoder_hidden": (8,)}}, 3)
    check_settings(path, {}, config, 4)  # written before settings were stored


def test_a_setting_that_is_younger_than_the_checkpoint_had_its_default(tmp_path):
    path, state = tmp_path / "c.pt", {"seed": 3, "config": {"horizon": 15}}
    defaults = {"horizon": 20, "keep": "last"}
    check_settings(path, state, {"horizon": 15, "keep": "last"}, 3, defaults)
    with pytest.raises(CheckpointError, match="made with keep = 'last' instead of 'best';"):
        check_settings(path, state, {"horizon": 15, "keep": "best"}, 3, defaults)


def _archive(path, entries, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in entries.items():
            with archive.open(name, "w") as file:
                for part in content:
                    file.write(part)
    return path


class _Call:
    """Pickled as a call of a function."""

    def __init__(self, function, *arguments):
        self.function, self.arguments = function, arguments

    def __reduce__(self):
        return self.function, self.arguments


def _with_entry(path, state, ending, parts, compression=zipfile.ZIP_STORED):
    """A checkpoint of which one entry of the archive is replaced."""
    save_checkpoint(path, state)
    with zipfile.ZipFile(path) as archive:
        entries = {name: [archive.read(name)] for name in archive.namelist()}
    (name,) = [name for name in entries if name.endswith(ending)]
    return _archive(path, entries | {name: parts}, compression)


BOMBS = {
    "compressed zeros": lambda path: _with_entry(
        path, {"w": torch.ones(4)}, "data/0", [bytes(1 << 20)] * 400, zipfile.ZIP_DEFLATED
    ),
    "a call that reserves memory": lambda path: _with_entry(
        path, {}, "data.pkl", [pickle.dumps({"version": 2, "a": _Call(bytearray, 1 << 31)}, protocol=2)]
    ),
    "a view that repeats one number": lambda path: save_checkpoint(
        path, {"w": torch.zeros(1).expand(1 << 32)}
    ),
}


@pytest.mark.parametrize("what", BOMBS)
def test_a_checkpoint_that_would_take_more_memory_than_its_file_is_refused(tmp_path, what):
    BOMBS[what](tmp_path / "c.pt")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(CheckpointError, match=r"c\.pt: damaged \("):
        load_checkpoint(tmp_path / "c.pt")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KiB
