"""The NumPy model is the torch model, on disk and without torch."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from deepkoco.agent import load_policy
from deepkoco.koopman import KoopmanModel, ModelConfig, export_model
from deepkoco.koopman.files.model_folder import ModelFolderError, read_model_folder, write_model_folder


@pytest.fixture
def model() -> KoopmanModel:
    torch.manual_seed(4)
    return KoopmanModel(3, 2, ModelConfig(3, 0.05, (8, 7), (6,)))


def test_numpy_and_torch_agree_on_single_points_and_batches(model):
    exported = export_model(model)
    rng = np.random.default_rng(0)
    o, a = rng.normal(size=(5, 3)), rng.normal(size=(5, 2))
    latent, matrix, factor = model.double().linearise(torch.from_numpy(o), torch.from_numpy(a))
    rows, c = exported.linearise(o, a)
    np.testing.assert_allclose(rows[:, 0], latent.detach(), atol=1e-12)
    np.testing.assert_allclose(rows[:, 1:].swapaxes(1, 2), matrix.detach(), atol=1e-12)
    np.testing.assert_allclose(c, factor.detach(), atol=1e-12)
    rows_2, c_2 = exported.linearise(o[2], a[2])
    np.testing.assert_allclose(rows_2, rows[2], atol=1e-12)
    np.testing.assert_allclose(c_2, c[2], atol=1e-12)


def test_eigenvalues_are_those_of_the_transition_matrix(model):
    expected = torch.linalg.eigvals(model.dynamics.matrix().detach()).numpy()
    ours = export_model(model).eigenvalues
    np.testing.assert_allclose(np.sort(np.abs(expected))[::2], np.sort(np.abs(ours)), rtol=1e-5)


def test_saved_model_is_read_back_bit_for_bit(model, tmp_path):
    exported = export_model(model)
    write_model_folder(exported, tmp_path / "m", {"note": "x"})
    loaded, config = read_model_folder(tmp_path / "m")
    assert config["note"] == "x"
    o, a = np.ones(3), np.ones(2)
    for one, other in zip(exported.linearise(o, a), loaded.linearise(o, a), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ({}, "'planner'"),
        ({"planner": {"horizon": 5}}, "'action_low'"),
        ({"planner": {"colour": 5}}, "colour"),
        ({"planner": {}, "action_low": [-1.0], "action_high": [1.0]}, "2 limits"),
    ],
)
def test_a_model_without_its_planner_is_named(extra, message, model, tmp_path):
    write_model_folder(export_model(model), tmp_path / "m", extra)
    with pytest.raises(ModelFolderError, match=message):
        load_policy(tmp_path / "m")


def test_control_runs_without_torch(model, tmp_path):
    planner = {"horizon": 5}
    limits = {"action_low": [-1.0, -1.0], "action_high": [1.0, 1.0]}
    write_model_folder(export_model(model), tmp_path / "m", {"planner": planner, **limits})
    code = (
        "import sys; from deepkoco.agent import load_policy\n"
        f"policy = load_policy({str(tmp_path / 'm')!r})\n"
        "policy.act([1.0, 0.0, 0.0]); policy.act([1.0, 0.0, 0.0])\n"
        "assert policy.statistics.failures == 0\n"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
