"""Frames: the NumPy encoder is the torch encoder, features are stacked in order, B stays outside the CNN."""

import dataclasses
import json
from copy import deepcopy

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.koopman import ExportedModel, KoopmanModel, ModelConfig, chunk_losses, export_model
from deepkoco.koopman.exported_frames import Convolution, ExportedFrameEncoder, FeatureHistory
from deepkoco.koopman.files.frame_arrays import frame_arrays, frame_settings, read_frame_encoder
from deepkoco.koopman.files.model_folder import ModelFolderError, read_model_folder, write_model_folder
from deepkoco.koopman.losses import ChunkBatch
from deepkoco.koopman.model.frame_encoder import FrameEncoder, FrameShapeError, stack_features

CONFIG = ModelConfig(3, 0.05, (12, 9), (7,), frame_features=5, frame_channels=(4, 6))


def random_frames(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


@pytest.fixture
def model() -> KoopmanModel:
    torch.manual_seed(5)
    return KoopmanModel((16, 12, 3), 2, CONFIG)


@pytest.fixture
def exported(model) -> ExportedModel:
    return export_model(model)


@settings(max_examples=20, deadline=None)
@given(
    height=st.integers(4, 40),
    width=st.integers(4, 40),
    channels=st.lists(st.integers(1, 6), min_size=1, max_size=3),
    seed=st.integers(0, 99),
)
def test_numpy_and_torch_give_the_same_features(height, width, channels, seed):
    torch.manual_seed(seed)
    config = ModelConfig(2, 0.05, (4,), (4,), frame_features=3, frame_channels=tuple(channels))
    model = KoopmanModel((height, width, 3), 1, config)
    encoder = export_model(model).frame_encoder
    frames = random_frames(2, 3, height, width, 3, seed=seed)
    expected = model.frame_encoder(torch.from_numpy(frames)).detach().numpy()
    # Rounding is relative to the summands, which may cancel: absolute weights on a white frame bound their sum.
    summands = deepcopy(model.frame_encoder)
    for weight in summands.parameters():
        weight.data.abs_()
    bound = summands(torch.full((1, 1, height, width, 3), 255, dtype=torch.uint8)).detach().numpy().max()
    np.testing.assert_allclose(encoder.encode(frames), expected, rtol=0.0, atol=1e-6 * bound)
    np.testing.assert_allclose(encoder.encode(frames[1, 2]), expected[1, 2], rtol=0.0, atol=1e-6 * bound)


def test_a_convolution_worked_out_by_hand():
    # One 4 x 4 patch of 255 in red only: each pixel is 1 - 1/2 in red, -1/2 in green and blue.
    weight = np.zeros((2, 3, 4, 4))
    weight[0, 0], weight[0, 1] = 1.0, 2.0  # 16 (0.5 - 2 * 0.5) + 3 = -5 -> 0
    weight[1, 0, 3, 1], weight[1, 2, 0, 0] = 4.0, -6.0  # 4 * 0.5 + 6 * 0.5 + 1 = 6
    last = (np.array([[7.0, 10.0]]), np.array([0.25]))
    encoder = ExportedFrameEncoder(
        (4, 4, 3), 2, (Convolution(4, 4, 0),), ((weight, np.array([3.0, 1.0])),), last
    )
    frame = np.zeros((4, 4, 3), np.uint8)
    frame[..., 0] = 255
    np.testing.assert_allclose(encoder.encode(frame), [60.25], rtol=1e-6)


def test_an_observation_is_the_newest_features_and_their_differences_times_three():
    features = torch.tensor([[[1.0], [2.0], [4.0], [9.0]]])
    expected = [[[4.0, 6.0, 3.0], [9.0, 15.0, 6.0]]]  # 4, 3 (4 - 2), 3 (2 - 1); 9, 3 (9 - 4), 3 (4 - 2)
    assert stack_features(features, 3).tolist() == expected
    assert stack_features(features, 1).tolist() == features.tolist()


def test_the_history_stacks_as_training_does_and_starts_with_the_first_frame_repeated(exported):
    encoder = exported.frame_encoder
    frames = random_frames(5, 16, 12, 3)
    history = FeatureHistory(encoder)
    history.push(random_frames(16, 12, 3, seed=1))
    history.reset()
    seen = np.stack([history.push(frame) for frame in frames])
    features = torch.from_numpy(encoder.encode(frames[[0, 0, 0, 1, 2, 3, 4]]))
    np.testing.assert_allclose(seen, stack_features(features[None], 3)[0], atol=1e-6)
    assert not seen[0, 5:].any()
    assert seen[1, 5:10].any()


def test_latents_and_input_matrices_of_frames_are_those_of_numpy_step_by_step(model, exported):
    frames, actions = random_frames(2, 6, 16, 12, 3), np.random.default_rng(1).normal(size=(2, 4, 2))
    with torch.no_grad():
        parts = model.encoder_and_factors(torch.from_numpy(frames), torch.from_numpy(actions).float(), 3)
    latents, matrices, factors = (part.numpy() for part in parts)
    history = FeatureHistory(exported.frame_encoder)
    history.push(frames[:, 0])
    history.push(frames[:, 1])
    for k in range(4):
        rows, factor = exported.linearise(history.push(frames[:, k + 2]), actions[:, k])
        np.testing.assert_allclose(rows[:, 0], latents[:, k], atol=1e-5)
        if k < 3:
            np.testing.assert_allclose(rows[:, 1:].swapaxes(1, 2), matrices[:, k], atol=1e-5)
            np.testing.assert_allclose(factor, factors[:, k], atol=1e-5)


def test_the_input_matrix_is_the_derivative_of_the_latent_with_the_frames_held(model):
    frames = torch.from_numpy(random_frames(1, 3, 16, 12, 3))
    action = torch.tensor([[[0.3, -0.7]]])

    def latent(a):
        return model.encoder_and_factors(frames, a, 1)[0].squeeze()

    expected = torch.func.jacrev(latent)(action).squeeze()  # (2P, M)
    matrix = model.encoder_and_factors(frames, action, 1)[1].squeeze()
    torch.testing.assert_close(matrix, expected, atol=1e-6, rtol=1e-5)


def test_latents_cost_factors_and_losses_teach_every_layer_of_the_frame_encoder():
    torch.manual_seed(0)
    model = KoopmanModel((16, 12, 3), 2, ModelConfig(3, 0.05, (30, 30), (30,)))
    generator = torch.Generator().manual_seed(0)
    batch = ChunkBatch(
        torch.from_numpy(random_frames(2, 10, 16, 12, 3)),
        torch.randn(2, 8, 2, generator=generator),
        torch.rand(2, 8, generator=generator),
        torch.ones(2, 5),
    )
    latents, _, factors = model.encoder_and_factors(batch.observations, batch.actions, 5)
    total = chunk_losses(model, batch, 3, 10.0).total
    weights = [parameter for parameter in model.frame_encoder.parameters() if parameter.ndim > 1]
    for source in (latents, factors, total):
        gradients = torch.autograd.grad(source.square().sum(), weights, retain_graph=True)
        assert all(gradient.abs().max() > 0 for gradient in gradients)


@pytest.mark.parametrize("seed", range(5))
def test_the_predicted_cost_starts_with_one_sign_of_y_for_all_frames(seed):
    torch.manual_seed(seed)
    model = KoopmanModel((64, 64, 3), 1, ModelConfig())
    noise = random_frames(2, 4, 64, 64, 3, seed=seed)
    plain = np.repeat(np.array([0, 255], np.uint8), 4 * 64 * 64 * 3).reshape(noise.shape)
    for frames in (noise, plain):
        latent, _, factor = model.encoder_and_factors(torch.from_numpy(frames), torch.zeros(2, 2, 1), 2)
        y = (factor.squeeze(-2) * latent).sum(-1)
        assert y.min() > 0.5
        assert y.std() < y.mean()


def test_frames_that_are_too_small_are_named():
    with pytest.raises(FrameShapeError, match=r"\(3, 64, 3\)"):
        FrameEncoder((3, 64, 3), (4,), 2)


def test_a_model_on_frames_is_read_back_bit_for_bit(exported, tmp_path):
    write_model_folder(exported, tmp_path / "m", {})
    loaded, _ = read_model_folder(tmp_path / "m")
    frame = random_frames(16, 12, 3)
    one, other = (FeatureHistory(m.frame_encoder).push(frame) for m in (exported, loaded))
    np.testing.assert_array_equal(one, other)
    assert loaded.frame_encoder.frames == 3


def without(name):
    return lambda entry: {k: v for k, v in entry.items() if k != name}


def with_convolution(**changes):
    def damage(entry):
        first, *others = entry["convolutions"]
        return {**entry, "convolutions": [{**first, **changes}, *others]}

    return damage


@pytest.mark.parametrize(
    ("damage", "kind", "message"),
    [
        (without("frames"), KeyError, "frames"),
        (lambda entry: {**entry, "frames": -1}, ValueError, "frames = '-1'"),
        (lambda entry: {**entry, "frames": True}, ValueError, "frames = 'True'"),
        (lambda entry: {**entry, "frame_shape": [16, 12, 1]}, ValueError, "16, 12, 1"),
        (lambda entry: {**entry, "frame_shape": [64, 64, 3]}, ValueError, r"frame_encoder\.2\.weight"),
        (lambda entry: {**entry, "frame_shape": [3, 3, 3]}, ValueError, "leaves nothing"),
        (lambda entry: {**entry, "difference_gain": float("nan")}, ValueError, "difference_gain"),
        (lambda entry: {**entry, "convolutions": []}, ValueError, "takes no frames"),
        (
            lambda entry: {**entry, "convolutions": entry["convolutions"][:1]},
            ValueError,
            r"frame_encoder\.1\.weight",
        ),
        (with_convolution(stride=0), ValueError, "stride = '0'"),
        (with_convolution(kernel=5), ValueError, r"frame_encoder\.0\.weight"),
        (with_convolution(padding=10**9), ValueError, "below the kernel"),
        (with_convolution(padding=1), ValueError, "it should be 0"),
        (lambda _: 7, TypeError, "not subscriptable"),
    ],
)
def test_damaged_settings_of_a_frame_encoder_are_named(damage, kind, message, exported):
    entry = json.loads(json.dumps(frame_settings(exported.frame_encoder)))
    with pytest.raises(kind, match=message):
        read_frame_encoder(damage(entry), frame_arrays(exported.frame_encoder))


def test_a_model_that_takes_other_features_than_its_frame_encoder_gives_is_refused(exported, tmp_path):
    narrow = dataclasses.replace(
        exported, frame_encoder=dataclasses.replace(exported.frame_encoder, frames=2)
    )
    write_model_folder(narrow, tmp_path / "m", {})
    with pytest.raises(ModelFolderError, match="features of 2 frames"):
        read_model_folder(tmp_path / "m")
