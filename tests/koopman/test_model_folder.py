"""Folders of models: every damage is found, and nobody's file does harm."""

import hashlib
import json
import os
import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.numpy import save

from deepkoco.koopman import ExportedModel, KoopmanModel, ModelConfig, export_model
from deepkoco.koopman.files.model_folder import ModelFolderError, read_model_folder, write_model_folder
from deepkoco.koopman.files.network_arrays import network_parts
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel, target_cost
from deepkoco.koopman.lifting.lifting import (
    FunctionLifting,
    Identity,
    LiftingError,
    Polynomial,
    RadialBasis,
    RandomFourier,
    ScaledRadialBasis,
    TimeDelays,
)
from deepkoco.koopman.lifting.network import Network

RNG = np.random.default_rng(0)
LIFTINGS = [
    Identity(3),
    Polynomial(3, 2, False, True),
    RadialBasis(RNG.normal(size=(4, 3)), "gauss", 0.7),
    RandomFourier(RNG.normal(size=(4, 3)), False),
    TimeDelays(3, 2, 2),
    ScaledRadialBasis(RNG.normal(size=3), RNG.normal(size=(3, 2)), RNG.normal(size=(4, 2))),
    ScaledRadialBasis(np.zeros(3), np.eye(3), np.zeros((0, 3))),
    Network(((RNG.normal(size=(5, 3)), RNG.normal(size=5)), (RNG.normal(size=(2, 5)), np.zeros(2))), "elu"),
]


def make_network() -> ExportedModel:
    torch.manual_seed(4)
    return export_model(KoopmanModel(3, 2, ModelConfig(3, 0.05, (8, 7), (6,), decoder_hidden=(4,))))


def make_lifted(lifting=LIFTINGS[0]) -> LiftedLinearModel:
    rng = np.random.default_rng(1)
    p = lifting.size
    cost = target_cost(np.eye(p), np.ones(p), np.zeros(p), 0.1)
    return LiftedLinearModel(lifting, rng.normal(size=(p, p)), rng.normal(size=(p, 2)), cost, 0.1)


def same(one, other) -> bool:
    """Whether two models give the same numbers at one point."""
    o, a = np.full(one.observation_size, 0.3), np.full(one.action_size, -0.2)
    pairs = zip(one.linearise(o, a), other.linearise(o, a), strict=True)
    same_constants = (one.time_step, one.action_weight) == (other.time_step, other.action_weight)
    return same_constants and all(np.array_equal(x, y) for x, y in pairs)


def forge(folder: Path, config: dict | None = None, weights: bytes | None = None) -> None:
    """Change files as somebody would who knows how the checksums are made."""
    weights = (folder / "model.safetensors").read_bytes() if weights is None else weights
    config = json.loads((folder / "config.json").read_text()) if config is None else dict(config)
    config.pop("checksums", None)
    digest = hashlib.sha256(json.dumps(config, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
    sums = {"config.json": digest, "model.safetensors": hashlib.sha256(weights).hexdigest()}
    (folder / "config.json").write_text(json.dumps({**config, "checksums": sums}))
    (folder / "model.safetensors").write_bytes(weights)


@pytest.fixture
def folder(tmp_path) -> Path:
    write_model_folder(make_network(), tmp_path / "m", {"note": "x"})
    return tmp_path / "m"


@pytest.mark.parametrize("model", [make_network(), *map(make_lifted, LIFTINGS)])
def test_a_model_is_read_back_bit_for_bit(model, tmp_path):
    write_model_folder(model, tmp_path / "m", {"note": "x"})
    loaded, config = read_model_folder(tmp_path / "m")
    assert config["note"] == "x"
    assert same(model, loaded)
    assert {p.name for p in (tmp_path / "m").iterdir()} == {"config.json", "model.safetensors", "README.md"}


def test_a_function_cannot_be_written(tmp_path):
    with pytest.raises(LiftingError, match="cannot be written"):
        write_model_folder(make_lifted(FunctionLifting(np.sin, 3, 3)), tmp_path / "m", {})
    assert not any(tmp_path.iterdir())


def test_a_model_of_another_kind_cannot_be_written(tmp_path):
    with pytest.raises(
        ModelFolderError, match="Identity cannot be written; the kinds are network, lifted_linear"
    ):
        write_model_folder(Identity(3), tmp_path / "m", {})  # pyright: ignore[reportArgumentType]
    assert not any(tmp_path.iterdir())


def test_an_existing_folder_is_not_overwritten(folder):
    with pytest.raises(ModelFolderError, match="exists"):
        write_model_folder(make_network(), folder, {})


def test_the_first_version_of_the_format_is_still_read(folder):
    config = json.loads((folder / "config.json").read_text())
    del config["checksums"], config["kind"]
    (folder / "config.json").write_text(json.dumps({**config, "version": 1}))
    assert same(read_model_folder(folder)[0], make_network())


def without(*names):
    return lambda config: {k: v for k, v in config.items() if k not in names}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda c: {**c, "version": 99},
            "version '99'; this release reads 'deepkoco-model' versions 1 and 2",
        ),
        (lambda c: {**c, "format": "other"}, "'other'"),
        (lambda c: {**c, "kind": "pickle"}, "'pickle'"),
        (lambda c: {**c, "kind": ["network"]}, "kind"),
        (without("layers"), "'layers' is missing"),
        (without("time_step"), "'time_step' is missing"),
        (lambda c: {**c, "time_step": None}, "time_step = 'None'"),
        (lambda c: {**c, "time_step": -1.0}, "above 0"),
        (lambda c: {**c, "time_step": 10**400}, "time_step"),
        (lambda c: {**c, "action_weight": True}, "action_weight"),
        (lambda c: {**c, "layers": 3}, "damaged"),
        (lambda c: {**c, "layers": {"encoder": 9, "cost_factor": 2}}, r"encoder\.3\.weight"),
        (lambda c: {**c, "layers": {"encoder": 10**12, "cost_factor": 2}}, "at most 100"),
        (lambda c: {**c, "layers": {"encoder": 1, "cost_factor": 2}}, "encoder ends in 8 entries"),
        (lambda c: {**c, "layers": {"encoder": 3, "cost_factor": 2}}, "belongs to no part"),
        (lambda c: {**c, "action_size": 5}, "action_size"),
        (lambda c: {**c, "action_size": 2.0}, "action_size"),
        (lambda c: {**c, "frame_encoder": {"frame_shape": [10**9, 10**9, 3]}}, "damaged"),
    ],
)
def test_what_a_stranger_wrote_is_checked(change, message, folder):
    forge(folder, change(json.loads((folder / "config.json").read_text())))
    with pytest.raises(ModelFolderError, match=message):
        read_model_folder(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "callable"}, "reads identity"),
        ({"kind": "polynomial", "observation_size": 3, "degree": 10**9}, "too many"),
        ({"kind": "polynomial", "observation_size": 3, "degree": 0}, "degree"),
        ({"kind": "time_delays", "observation_size": 3, "delays": 10**9, "stride": 1}, "1 to 10000"),
        ({"kind": "polynomial", "observation_size": 0, "degree": 10**15}, "at least 1"),
        ({"kind": "identity", "observation_size": "3"}, "observation_size"),
        ({"kind": "identity", "observation_size": 4}, "A has shape"),
        ({"kind": "network", "layers": 10**9, "activation": "relu"}, "missing"),
    ],
)
def test_hostile_liftings_are_refused(change, message, tmp_path):
    write_model_folder(make_lifted(), tmp_path / "m", {})
    config = json.loads((tmp_path / "m" / "config.json").read_text())
    defaults = {"include_bias": True, "interaction_only": False}
    forge(tmp_path / "m", {**config, "lifting": {**defaults, **change}})
    with pytest.raises(ModelFolderError, match=message):
        read_model_folder(tmp_path / "m")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"{", "not JSON"),
        (b"[1]", "named entries"),
        (b"", "not JSON"),
        (b"\xff\xfe\x00", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b'{"a":' * 100_000, "not JSON"),
        (b'{"format": "deepkoco-model", "format": "x"}', "twice"),
        (b'{"time_step": NaN}', "no finite number"),
        (b'{"time_step": 1e999}', "no finite number"),
        (b'{"time_step": ' + b"9" * 10_000 + b"}", "not JSON"),
        (b" " * ((1 << 20) + 1), "at most 1048576"),
        (b'{"format": "deepkoco-model", "version": 2}', "checksums"),
        (b'{"format": "deepkoco-model", "version": 2, "checksums": 3}', "checksum does not fit"),
        (b'{"format": "deepkoco-model", "version": [[]]}', "version"),
    ],
)
def test_damaged_settings_are_named(text, message, folder):
    (folder / "config.json").write_bytes(text)
    with pytest.raises(ModelFolderError, match=message) as caught:
        read_model_folder(folder)
    assert len(str(caught.value)) < 500


def tensor_file(header: dict | bytes, data: bytes = b"") -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + data


@pytest.mark.parametrize(
    "weights",
    [
        b"",
        b"\xff" * 8,
        struct.pack("<Q", 1 << 40) + b"{}",
        tensor_file({"mu": {"dtype": "F64", "shape": [1 << 40], "data_offsets": [0, 8]}}, bytes(8)),
        tensor_file({"mu": {"dtype": "F64", "shape": [1 << 33, 1 << 33], "data_offsets": [0, 8]}}, bytes(8)),
        tensor_file({"mu": {"dtype": "BF16", "shape": [4], "data_offsets": [0, 8]}}, bytes(8)),
        tensor_file({"mu": {"dtype": "C64", "shape": [1], "data_offsets": [0, 8]}}, bytes(8)),
        tensor_file({"mu": {"dtype": "I64", "shape": [1], "data_offsets": [0, 8]}}, bytes(8)),
        tensor_file(b"[" * 10_000),
        tensor_file(b"\xff\xfe"),
        tensor_file({}),
    ],
)
def test_weights_that_a_stranger_wrote_are_checked(weights, folder):
    forge(folder, weights=weights)
    with pytest.raises(ModelFolderError, match=r"damaged|float32"):
        read_model_folder(folder)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_weights_that_are_no_numbers_are_named(number, tmp_path):
    model = make_network()
    write_model_folder(replace(model, mu=np.full_like(model.mu, number)), tmp_path / "m", {})
    with pytest.raises(ModelFolderError, match="'mu' holds numbers that are not finite"):
        read_model_folder(tmp_path / "m")


def test_links_may_not_leave_the_folder(folder, tmp_path):
    os.replace(folder / "model.safetensors", tmp_path / "elsewhere")
    (folder / "model.safetensors").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ModelFolderError, match="leaves its folder"):
        read_model_folder(folder)
    assert same(read_model_folder(folder, root=tmp_path)[0], make_network())  # as in the cache of a hub
    (folder / "config.json").unlink()
    (folder / "config.json").symlink_to("config.json")
    with pytest.raises(ModelFolderError, match=r"no config\.json"):
        read_model_folder(folder)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no named pipes")
def test_what_is_no_file_is_refused_at_once(folder):
    (folder / "config.json").unlink()
    os.mkfifo(folder / "config.json")
    with pytest.raises(ModelFolderError, match="not a file"):
        read_model_folder(folder)
    (folder / "config.json").unlink()
    (folder / "config.json").mkdir()
    with pytest.raises(ModelFolderError, match=r"config\.json"):
        read_model_folder(folder)


FUZZ = settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
FILES = st.sampled_from(["config.json", "model.safetensors"])


def check_damage(folder: Path, name: str, damaged: bytes) -> None:
    """A damaged file is refused in one sentence, or says the same as before."""
    path = folder / name
    whole = path.read_bytes()
    try:
        path.write_bytes(damaged)
        model, _ = read_model_folder(folder)
    except ModelFolderError as error:
        assert str(folder) in str(error)  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert name == "config.json" or damaged == whole
        assert same(model, make_network())
    finally:
        path.write_bytes(whole)


@FUZZ
@given(name=FILES, place=st.integers(0), bit=st.integers(0, 7))
def test_every_flipped_bit_is_found(name, place, bit, folder):
    damaged = bytearray((folder / name).read_bytes())
    damaged[place % len(damaged)] ^= 1 << bit
    check_damage(folder, name, bytes(damaged))


@FUZZ
@given(name=FILES, place=st.integers(0))
def test_every_truncation_is_found(name, place, folder):
    whole = (folder / name).read_bytes()
    check_damage(folder, name, whole[: place % len(whole)])


@FUZZ
@given(name=FILES, place=st.integers(0), junk=st.binary(min_size=1, max_size=40))
def test_junk_in_a_file_is_found(name, place, junk, folder):
    whole = (folder / name).read_bytes()
    place %= len(whole)
    check_damage(folder, name, whole[:place] + junk + whole[place + len(junk) :])


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """One folder of each kind of model, and its settings."""
    folders = {}
    for name, model in (("network", make_network()), ("lifted", make_lifted())):
        folders[name] = tmp_path_factory.mktemp("fuzz") / name
        write_model_folder(model, folders[name], {})
    return {name: (folder, (folder / "config.json").read_text()) for name, folder in folders.items()}


@FUZZ
@given(
    kind=st.sampled_from(["network", "lifted"]),
    names=st.sampled_from(
        ["kind", "time_step", "action_weight", "action_size", "layers", "frame_encoder", "lifting"]
    ),
    inner=st.sampled_from(["", "encoder", "decoder", "kind", "observation_size"]),
    value=JSON_VALUES,
)
def test_any_value_in_any_entry_is_read_or_refused(kind, names, inner, value, stored):
    folder, text = stored[kind]
    config = json.loads(text)
    if inner and isinstance(config.get(names), dict):
        config[names][inner] = value
    else:
        config[names] = value
    forge(folder, config)
    try:
        read_model_folder(folder)
    except ModelFolderError as error:
        assert "\n" not in str(error)  # noqa: PT017


@FUZZ
@given(
    name=st.sampled_from(["mu", "omega", "encoder.0.weight", "encoder.1.bias", "cost_factor.1.weight", "x"]),
    shape=st.lists(st.integers(0, 9), max_size=4),
)
def test_any_shape_of_any_array_is_read_or_refused(name, shape, stored):
    folder, text = stored["network"]
    arrays = dict(network_parts(make_network())[1])
    fits = name in arrays and arrays[name].shape == tuple(shape)
    forge(folder, json.loads(text), save({**arrays, name: np.zeros(shape)}))
    if fits:
        read_model_folder(folder)
    else:
        with pytest.raises(ModelFolderError, match="damaged"):
            read_model_folder(folder)


@pytest.mark.parametrize("make", [make_network, make_lifted])
def test_a_weight_of_each_action_is_kept(make, tmp_path):
    model, weights = make(), np.array([0.1, 20.0])
    if isinstance(model, ExportedModel):
        model = replace(model, action_weight=weights)
    else:
        cost = replace(model.cost, action_weight=weights)
        model = LiftedLinearModel(model.lifting, model.transition, model.inputs, cost, model.time_step)
    write_model_folder(model, tmp_path / "m", {})
    read, _ = read_model_folder(tmp_path / "m")
    np.testing.assert_array_equal(read.action_weight, weights)
    config = json.loads((tmp_path / "m" / "config.json").read_text())
    for wrong in ([0.1], [0.1, -1.0], [0.1, "2"]):
        forge(tmp_path / "m", {**config, "action_weight": wrong})
        with pytest.raises(ModelFolderError):
            read_model_folder(tmp_path / "m")
