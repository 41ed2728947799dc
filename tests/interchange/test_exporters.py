"""Exported models compute the same numbers elsewhere."""

import json
import zipfile

import numpy as np
import pytest
import torch
from scipy.io import loadmat

from deepkoco.agent.stored_controller import StoredController
from deepkoco.cli.command_line import main
from deepkoco.interchange.exporters import ExportError, description, export
from deepkoco.interchange.loaded_model import LoadedModel, load
from deepkoco.interchange.torch_module import LinearisedModel
from deepkoco.koopman import KoopmanModel, ModelConfig, export_model
from deepkoco.koopman.lifting.episode_fit import fit_to_episodes
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel, target_cost
from deepkoco.koopman.lifting.lifting import Polynomial
from deepkoco.planning import PlannerConfig

RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(5, 3)), RNG.normal(size=(5, 2))
LIMITS = np.array([-1.0]), np.array([1.0])


def check_outputs(model, outputs, observation, action):
    latent, matrix, factor = (np.asarray(output) for output in outputs)
    np.testing.assert_allclose(latent, model.encode(observation, action), atol=1e-12)
    np.testing.assert_allclose(matrix, model.B(observation, action), atol=1e-12)
    np.testing.assert_allclose(factor, model.C(model.encode(observation, action)), atol=1e-12)


def image_model() -> LoadedModel:
    torch.manual_seed(0)
    exported = export_model(KoopmanModel((64, 64, 3), 1, ModelConfig(2, 0.05, (8,), (8,))))
    return LoadedModel(StoredController(exported, PlannerConfig(4), *LIMITS))


def lifted_model() -> LoadedModel:
    lifting = Polynomial(2, 2, False)
    cost = target_cost(np.eye(2, 5), [1.0, 0.1], [0.5, 0.0], 0.01)
    model = LiftedLinearModel(lifting, 0.9 * np.eye(5), np.ones((5, 1)), cost, 0.1)
    return LoadedModel(StoredController(model, PlannerConfig(4), *LIMITS))


def test_onnx_gives_latent_b_and_c_for_any_batch(folder, tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    assert main(["export-model", str(folder.parent), "--to", "onnx", "--out", str(tmp_path / "m.onnx")]) == 0
    model, session = load(folder), runtime.InferenceSession(tmp_path / "m.onnx")
    for rows in (slice(None), slice(1)):
        observation, action = (part[rows] for part in POINTS)
        outputs = session.run(["latent", "B", "C"], {"observation": observation, "action": action})
        check_outputs(model, outputs, observation, action)
    stored = json.loads(session.get_modelmeta().custom_metadata_map["deepkoco"])
    np.testing.assert_array_equal(stored["Lambda"], model.Lambda)
    assert stored["task"]["id"] == "Pendulum-v1"


def test_torch_export_gives_the_same_and_holds_the_constants(folder, tmp_path):
    export(load(folder), "torch", tmp_path / "m.pt2")
    extra = {"deepkoco.json": ""}
    program = torch.export.load(tmp_path / "m.pt2", extra_files=extra).module()
    outputs = [output.numpy() for output in program(*map(torch.from_numpy, POINTS))]
    check_outputs(load(folder), outputs, *POINTS)
    assert json.loads(extra["deepkoco.json"])["horizon"] == 5


def test_frames_go_through_the_exported_function():
    model = image_model()
    frames = RNG.integers(0, 256, (2, 3, 64, 64, 3), dtype=np.uint8)
    action = RNG.normal(size=(2, 1))
    outputs = LinearisedModel(model.latent_model)(torch.from_numpy(frames), torch.from_numpy(action))
    for output, expected in zip(
        outputs, (model.encode(frames, action), model.B(frames, action)), strict=False
    ):
        np.testing.assert_allclose(
            output.numpy(), expected, atol=1e-5
        )  # NumPy encodes frames in single precision


def test_networks_of_one_layer_are_exported_too():
    torch.manual_seed(1)
    exported = export_model(KoopmanModel(3, 2, ModelConfig(2, 0.05, (), ())))
    model = LoadedModel(StoredController(exported, PlannerConfig(4), -np.ones(2), np.ones(2)))
    check_outputs(model, LinearisedModel(exported)(*map(torch.from_numpy, POINTS)), *POINTS)


def read_arrays(path):
    readers = {
        ".npz": lambda: dict(np.load(path, allow_pickle=False)),
        ".mat": lambda: {k: v for k, v in loadmat(path).items() if k[0] != "_"},
        ".json": lambda: {k: np.array(v) for k, v in json.loads(path.read_text()).items()},
    }
    return readers[path.suffix]()


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".json"])
def test_arrays_are_enough_to_rebuild_the_function(suffix, folder, tmp_path):
    model = load(folder)
    export(model, "arrays", tmp_path / f"m{suffix}")
    arrays = read_arrays(tmp_path / f"m{suffix}")
    x = np.concatenate((POINTS[0][0], POINTS[1][0]))
    for i in range(3):
        x = arrays[f"encoder_W{i}"] @ (np.maximum(x, 0) if i else x) + arrays[f"encoder_b{i}"].ravel()
    np.testing.assert_allclose(x, model.encode(POINTS[0][0], POINTS[1][0]), atol=1e-12)
    np.testing.assert_array_equal(arrays["Lambda"], model.Lambda)
    assert float(np.squeeze(arrays["horizon"])) == 5
    np.testing.assert_array_equal(arrays["action_high"].ravel(), model.action_high)


def test_a_model_with_a_lifting_that_torch_does_not_know_is_exported_as_arrays_only(tmp_path):
    model = lifted_model()
    export(model, "arrays", tmp_path / "m.npz")
    arrays = read_arrays(tmp_path / "m.npz")
    np.testing.assert_array_equal(arrays["A"], 0.9 * np.eye(5))
    assert (arrays["lifting_degree"], arrays["lifting_include_bias"]) == (2, 0)
    with pytest.raises(ExportError, match="--to arrays"):
        export(model, "torch", tmp_path / "m.pt2")
    assert [p.name for p in tmp_path.iterdir()] == ["m.npz"]


@pytest.mark.parametrize("centres", [0, 4])
def test_edmdc_that_a_run_has_kept_is_exported_for_torch(centres, tmp_path):
    generator = np.random.default_rng(1)
    observations, actions = generator.normal(size=(2, 60, 3)), generator.uniform(-1.0, 1.0, (2, 60, 2))
    costs = np.square(observations).sum(-1)
    model = fit_to_episodes(observations, actions, costs, 0.05, 0.01, generator, centres)
    loaded = LoadedModel(StoredController(model, PlannerConfig(4), -np.ones(2), np.ones(2)))
    export(loaded, "torch", tmp_path / "m.pt2")
    program = torch.export.load(tmp_path / "m.pt2").module()
    for rows in (slice(None), slice(1)):
        observation, action = (part[rows] for part in POINTS)
        check_outputs(
            loaded, program(torch.from_numpy(observation), torch.from_numpy(action)), observation, action
        )
    at_a_centre = observations[0, :5].copy()
    check_outputs(
        loaded, program(torch.from_numpy(at_a_centre), torch.from_numpy(POINTS[1])), at_a_centre, POINTS[1]
    )


def test_what_cannot_be_exported_is_named(folder, tmp_path, capsys):
    model = load(folder)
    (tmp_path / "there.npz").touch()
    for form, name, message in (
        ("arrays", "there.npz", "exists already"),
        ("arrays", "m.csv", "no ending"),
        ("arrays", "nowhere/m.npz", "no folder"),
        ("pickle", "m.pkl", "choose one of"),
    ):
        with pytest.raises(ExportError, match=message):
            export(model, form, tmp_path / name)
    arguments = ["export-model", str(tmp_path / "none"), "--to", "arrays", "--out", str(tmp_path / "m.npz")]
    assert main(arguments) == 2
    assert "no such folder" in capsys.readouterr().err


def test_a_run_is_exported_and_one_without_a_model_says_what_to_do(folder, tmp_path, capsys):
    target = ["--to", "arrays", "--out", str(tmp_path / "m.npz")]
    assert main(["export-model", str(folder.parent), *target]) == 0
    unfinished = tmp_path / "unfinished"
    unfinished.mkdir()
    assert main(["export-model", str(unfinished), *target]) == 2
    told = capsys.readouterr().err
    assert "give the folder of a finished training run, or of an exported model" in told
    (unfinished / "config.yaml").touch()
    (unfinished / "metrics.csv").touch()
    assert main(["export-model", str(unfinished), *target]) == 2
    assert f"is not finished, it has no model yet; continue it with deepkoco train resume={unfinished}" in (
        capsys.readouterr().err
    )


def test_an_array_file_holds_no_pickle(folder, tmp_path):
    export(load(folder), "arrays", tmp_path / "m.npz")
    with zipfile.ZipFile(tmp_path / "m.npz") as archive:
        for name in archive.namelist():
            with archive.open(name) as file:
                np.lib.format.read_array(file, allow_pickle=False)
    assert json.loads(description(load(folder)))["training"]["episodes"] == 400


def test_casadi_plans_the_same_action(folder):
    casadi = pytest.importorskip("casadi")
    model = load(folder)
    observation = np.array([0.5, -0.3, 0.2])
    first = model.act(observation)
    s, b = model.encode(observation, first), model.B(observation, first)
    c = model.C(s)
    steps = casadi.SX.sym("da", 2, model.planner.horizon)
    latent, action, cost, actions = casadi.DM(s), casadi.DM(first), 0, []
    for k in range(model.planner.horizon):
        latent = model.Lambda @ latent + b @ steps[:, k]
        action = action + steps[:, k]
        cost += casadi.sumsqr(c @ latent) + model.action_weight * casadi.sumsqr(action)
        cost += model.planner.increment_weight * casadi.sumsqr(steps[:, k])
        actions.append(action)
    limits = model.planner.horizon
    solver = casadi.qpsol(
        "plan",
        "qrqp",
        {"x": casadi.vec(steps), "f": cost, "g": casadi.vertcat(*actions)},
        {"print_iter": False, "print_header": False},
    )
    found = solver(lbg=np.tile(model.action_low, limits), ubg=np.tile(model.action_high, limits))
    np.testing.assert_allclose(first + np.array(found["x"]).ravel()[:2], model.act(observation), atol=1e-5)


def test_a_written_model_is_exported_from_its_folder(tmp_path):
    model = lifted_model()
    model.save(tmp_path / "m")
    assert (
        main(["export-model", str(tmp_path / "m"), "--to", "arrays", "--out", str(tmp_path / "m.mat")]) == 0
    )
    np.testing.assert_array_equal(read_arrays(tmp_path / "m.mat")["Lambda"], model.Lambda)
