"""A forward model fitted to episodes predicts, is stored whole and is refused where it cannot be."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from deepkoco.agent.buffer import Episode
from deepkoco.agent.forward_fit import ForwardFitConfig, fit_forward_model
from deepkoco.koopman.files.folder_files import ModelFolderError
from deepkoco.koopman.files.forward_files import read_forward_model, write_forward_model
from deepkoco.koopman.forward_model import ForwardModelError

SMALL = ForwardFitConfig(hidden=(16,), horizon=3, updates=600, batch=64)


def episodes(count=8, length=40):
    """A pendulum without friction, explicit Euler: angle and speed."""
    generator = torch.Generator().manual_seed(1)
    made = []
    for _ in range(count):
        x = torch.randn(2, generator=generator)
        actions = torch.randn(length, 1, generator=generator)
        observations = []
        for action in actions:
            observations.append(x)
            x = torch.stack((x[0] + 0.05 * x[1], x[1] + 0.05 * (action[0] - torch.sin(x[0]))))
        made.append(Episode(torch.stack(observations), actions, torch.zeros(length)))
    return made


@pytest.fixture(scope="module")
def fitted():
    return fit_forward_model(episodes(), 0.05, 0, SMALL)


def test_it_predicts_episodes_that_it_was_not_fitted_to(fitted):
    assert len(fitted.errors) == SMALL.horizon
    spread = torch.cat([e.observations for e in episodes()[:-1]]).std(0)
    held_out = episodes()[-1].observations
    for steps, error in enumerate(fitted.errors, 1):
        staying = ((held_out[steps:] - held_out[:-steps]) / spread).square().mean().sqrt().item()
        assert error < 0.4 * staying


def test_the_arrays_predict_what_the_network_does(fitted):
    episode = episodes()[-1]
    observations, actions = episode.observations.double().numpy(), episode.actions.double().numpy()
    steps = np.arange(1.0, SMALL.horizon)
    errors = [
        fitted.model.predict(observations[k], SMALL.horizon, steps, actions[k : k + SMALL.horizon])
        - observations[k + SMALL.horizon]
        for k in range(len(actions) - SMALL.horizon)
    ]
    spread = np.concatenate([e.observations.numpy() for e in episodes()[:-1]]).std(0, ddof=1)
    assert np.sqrt(np.square(errors / spread).mean()) == pytest.approx(fitted.errors[-1], rel=1e-4)


def test_the_same_seed_gives_the_same_bytes_and_leaves_the_callers_generator_alone(fitted):
    torch.manual_seed(4)
    before = torch.get_rng_state()
    again = fit_forward_model(episodes(), 0.05, 0, SMALL)
    assert torch.equal(torch.get_rng_state(), before)
    for (w, b), (w2, b2) in zip(again.model.layers, fitted.model.layers, strict=True):
        assert np.array_equal(w, w2)
        assert np.array_equal(b, b2)


def test_a_stored_model_is_read_as_it_was(fitted, tmp_path):
    write_forward_model(fitted.model, tmp_path / "forward", fitted.errors)
    read = read_forward_model(tmp_path / "forward")
    x, a = np.array([0.3, -0.2]), np.array([[0.4]])
    assert np.array_equal(read.predict(x, 4.5, np.zeros(0), a), fitted.model.predict(x, 4.5, np.zeros(0), a))
    with pytest.raises(ModelFolderError, match="exists"):
        write_forward_model(fitted.model, tmp_path / "forward")


def test_a_damaged_file_and_another_kind_of_model_are_refused(fitted, tmp_path):
    write_forward_model(fitted.model, tmp_path / "forward")
    path = tmp_path / "forward" / "model.safetensors"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    with pytest.raises(ModelFolderError, match="damaged or changed"):
        read_forward_model(tmp_path / "forward")


def test_frames_and_short_episodes_are_refused():
    frames = Episode(torch.zeros(9, 4, 4, 3, dtype=torch.uint8), torch.zeros(9, 1), torch.zeros(9))
    with pytest.raises(ForwardModelError, match="frames"):
        fit_forward_model([frames], 0.05, 0)
    with pytest.raises(ForwardModelError, match="longer than 3"):
        fit_forward_model(episodes(1, 3), 0.05, 0, SMALL)


def test_a_robot_bridges_delays_without_torch(fitted, tmp_path):
    write_forward_model(fitted.model, tmp_path / "forward")
    code = (
        "import sys\n"
        "from pathlib import Path\n"
        "from deepkoco.agent import DelayedPolicy\n"
        "from deepkoco.agent.stored_controller import read_controller\n"
        "from deepkoco.koopman.files.forward_files import read_forward_model\n"
        "assert read_forward_model(Path(sys.argv[1])).action_size == 1\n"
        "sys.exit('torch' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "forward")], check=True)
