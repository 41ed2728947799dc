"""`deepkoco.load` gives the whole model, light and alone."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

import deepkoco
from deepkoco.agent import KoopmanPolicy
from deepkoco.agent.policy import ObservationError
from deepkoco.agent.stored_controller import StoredController, write_controller
from deepkoco.interchange import LoadedModel, hub
from deepkoco.interchange.hub import HubError, HubFolder, parse_hub_name
from deepkoco.koopman import KoopmanModel, ModelConfig, export_model
from deepkoco.koopman.files.model_folder import ModelFolderError
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel, target_cost
from deepkoco.koopman.lifting.lifting import FunctionLifting, LiftingError, TimeDelays
from deepkoco.koopman.model.cost import quadratic_cost
from deepkoco.planning import PlannerConfig

POINT, A = np.array([0.3, -0.5, 0.8]), np.array([0.2, -0.1])


def test_matrices_are_those_of_the_trained_model(folder, torch_model):
    model = deepkoco.load(folder)
    exact = torch_model.double()
    latent, matrix, factor = (
        t.detach().numpy() for t in exact.linearise(torch.tensor(POINT), torch.tensor(A))
    )
    np.testing.assert_allclose(model.encode(POINT, A), latent, atol=1e-12)
    np.testing.assert_allclose(model.B(POINT, A), matrix, atol=1e-12)
    np.testing.assert_allclose(model.C(latent), factor, atol=1e-12)
    np.testing.assert_allclose(model.Lambda, exact.dynamics.matrix().detach(), atol=1e-6)
    batch = np.stack((POINT, -POINT)), np.stack((A, A))
    assert model.B(*batch).shape == (2, 6, 2)
    assert model.C(model.encode(*batch)).shape == (2, 2, 6)
    expected = np.sort_complex(np.linalg.eigvals(exact.dynamics.matrix().detach().numpy()))
    np.testing.assert_allclose(np.sort_complex(model.eigenvalues), expected, atol=1e-6)


def test_rollouts_are_those_of_training(folder, torch_model):
    model, exact = deepkoco.load(folder), torch_model.double()
    increments = np.random.default_rng(0).normal(size=(7, 2))
    predicted = model.rollout(POINT, A, increments)
    latent, matrix, factor = exact.linearise(torch.tensor(POINT), torch.tensor(A))
    rolled = exact.dynamics.rollout(latent[None], matrix[None], torch.tensor(increments)[None])[0]
    np.testing.assert_allclose(predicted.latents[1:], rolled.detach(), atol=1e-6)
    np.testing.assert_allclose(predicted.actions, A + np.vstack((np.zeros(2), increments.cumsum(0))))
    actions = torch.tensor(predicted.actions[1:])[None]
    costs = quadratic_cost(factor[None, None], rolled[None], actions, exact.config.action_weight)[0]
    np.testing.assert_allclose(predicted.costs[1:], costs.detach(), atol=1e-6)
    assert model.rollout(POINT, A, np.zeros((0, 2))).costs.shape == (1,)


def test_a_loaded_model_acts_as_the_policy_does(folder, stored):
    model = deepkoco.load(folder.parent)
    policy = KoopmanPolicy(stored.model, stored.planner, stored.action_low, stored.action_high)
    rng = np.random.default_rng(0)
    for _ in range(2):
        for observation in rng.normal(size=(5, 3)):
            np.testing.assert_array_equal(model.act(observation), policy.act(observation))
        model.reset()
        policy.reset()
    assert (model.statistics.plans, model.statistics.failures) == (10, 0)


def test_a_model_says_what_it_is_for(folder):
    model = deepkoco.load(folder, horizon=3, solver="osqp")
    assert model.task["id"] == "Pendulum-v1"
    assert model.training["seed"] == 3
    assert (model.planner.horizon, model.planner.solver) == (3, "osqp")
    assert model.time_step == 0.05
    np.testing.assert_array_equal(model.action_high, [1.0, 2.0])
    card = (folder / "README.md").read_text()
    assert "Pendulum-v1" in card
    assert "| training seed | 3 |" in card


def test_loading_and_acting_need_no_torch_and_no_training_code(folder):
    code = (
        "import sys, deepkoco\n"
        "assert 'numpy' not in sys.modules\n"
        f"model = deepkoco.load({str(folder)!r})\n"
        "model.act([1.0, 0.0, 0.0]); model.act([1.0, 0.0, 0.0])\n"
        "model.rollout([1.0, 0.0, 0.0], [0.0, 0.0], [[0.1, 0.0]]); model.Lambda; model.eigenvalues\n"
        "heavy = {'torch', 'gymnasium', 'hydra', 'matplotlib', 'deepkoco.agent.training', 'deepkoco.envs'}\n"
        "print(sorted(heavy & set(sys.modules)), model.statistics.failures)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[] 0\n"


def test_a_saved_model_is_loaded_again(folder, tmp_path):
    deepkoco.load(folder, horizon=4).save(tmp_path / "copy")
    copy = deepkoco.load(tmp_path / "copy")
    assert copy.planner.horizon == 4
    np.testing.assert_array_equal(copy.encode(POINT, A), deepkoco.load(folder).encode(POINT, A))
    with pytest.raises(ModelFolderError, match="exists"):
        copy.save(tmp_path / "copy")


def test_a_model_on_images_takes_frames(tmp_path):
    torch.manual_seed(0)
    config = ModelConfig(2, 0.05, (8,), (8,))
    exported = export_model(KoopmanModel((64, 64, 3), 1, config))
    write_controller(StoredController(exported, PlannerConfig(4), *np.array([[-1.0], [1.0]])), tmp_path / "m")
    model = deepkoco.load(tmp_path / "m")
    frames = np.random.default_rng(0).integers(0, 256, (config.frames, 64, 64, 3), dtype=np.uint8)
    for frame in frames:
        model.act(frame)
    assert model.statistics.failures == 0
    history = exported.make_history()
    for frame in frames:
        entries = history.push(frame)
    np.testing.assert_array_equal(
        model.encode(frames, [0.1]), exported.linearise(entries, np.array([0.1]))[0][0]
    )
    assert model.B(np.stack((frames, frames)), [[0.1], [0.2]]).shape == (2, 4, 1)
    with pytest.raises(ObservationError, match="uint8"):
        model.act(frames[0] / 255.0)
    with pytest.raises(ObservationError, match="last ones"):
        model.encode(frames[0], [0.1])
    with pytest.raises(ObservationError, match=r"float64; give the last ones, .* uint8"):
        model.encode(frames / 255.0, [0.1])


def delayed_model(lifting=None):
    lifting = lifting or TimeDelays(1, 1)
    cost = target_cost(np.eye(1, 2), [1.0], [0.0], 0.01)
    a = np.array([[1.9, -0.95], [1.0, 0.0]])
    return LiftedLinearModel(lifting, a, [[0.01], [0.0]], cost, 0.1)


def test_an_imported_model_with_delays_controls_and_is_stored(tmp_path):
    stored = StoredController(delayed_model(), PlannerConfig(20, 1e-4), np.array([-3.0]), np.array([3.0]))
    write_controller(stored, tmp_path / "m")
    model = deepkoco.load(tmp_path / "m")
    position = [1.0, 1.0]
    for _ in range(60):
        action = model.act([position[-1]])
        position.append(1.9 * position[-1] - 0.95 * position[-2] + 0.01 * float(action[0]))
    assert abs(position[-1]) < 0.02
    np.testing.assert_allclose(model.encode([[0.3], [0.5]], [0.2]), [0.5, 0.3, 0.2, 1.0])
    np.testing.assert_allclose(model.encode([[0.5]], [0.2]), [0.5, 0.5, 0.2, 1.0])
    with pytest.raises(ModelFolderError, match=r"deepkoco\.load"):
        deepkoco.agent.policy.load_model(tmp_path / "m")
    function = StoredController(
        delayed_model(FunctionLifting(lambda o: o, 1, 2, 2)),
        PlannerConfig(2),
        np.array([-1.0]),
        np.array([1.0]),
    )
    with pytest.raises(LiftingError, match="cannot be written"):
        LoadedModel(function).save(tmp_path / "f")


@pytest.mark.parametrize(
    ("observation", "action", "increments"),
    [([1.0, 2.0], A, [[0, 0]]), (POINT, [0.1], [[0, 0]]), (POINT, A, [[0.0]]), (POINT, A, [0.0, 0.0])],
)
def test_what_does_not_fit_is_named(observation, action, increments, folder):
    with pytest.raises(ObservationError, match=r"shape|takes"):
        deepkoco.load(folder).rollout(observation, action, increments)


def test_a_latent_of_another_size_is_named(folder):
    with pytest.raises(ObservationError, match=r"latent has shape \(5,\); this model has \(\.\.\., 6\)"):
        deepkoco.load(folder).C(np.zeros(5))


def test_a_history_does_not_follow_the_array_of_its_caller():
    model, other = (
        LoadedModel(StoredController(delayed_model(), PlannerConfig(5), np.array([-3.0]), np.array([3.0])))
        for _ in range(2)
    )
    buffer = np.zeros(1)
    for position in (1.0, 0.7, 0.2, 0.1):
        buffer[0] = position
        assert model.act(buffer) == other.act([position])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"planner": PlannerConfig(10**7)}, "too much to plan"),
        ({"planner": PlannerConfig(100, method="cem", samples=10**6)}, "too much to plan"),
        ({"planner": PlannerConfig(5, method="cem", sample_iterations=10**9)}, "too much to plan"),
        ({"planner": PlannerConfig(0)}, "horizon"),
        ({"planner": PlannerConfig(5, solver="none such")}, "not installed"),
        ({"action_low": np.array([3.0, 3.0])}, "above action_high"),
        ({"action_low": np.array([3.0])}, "2 limits"),
        ({"action_low": np.array([-1e20, -1.0])}, "limits below 1e\\+20"),
    ],
)
def test_a_stored_planner_is_checked(change, message, stored, tmp_path):
    write_controller(replace(stored, **change), tmp_path / "m")
    with pytest.raises(ModelFolderError, match=message):
        deepkoco.load(tmp_path / "m")


def test_names_of_the_hub_are_told_from_folders(tmp_path, folder, monkeypatch):
    assert parse_hub_name("org/name") == HubFolder("org/name")
    assert parse_hub_name("hf://org/name@v1.0") == HubFolder("org/name", "v1.0")
    for name in ("name", "a/b/c", "../secret", "hf://", "org/name@", "org/na me", "/etc/passwd"):
        assert parse_hub_name(name) is None
    monkeypatch.chdir(folder.parents[1])
    assert deepkoco.load("run/model").time_step == 0.05  # a folder goes before the hub
    with pytest.raises(HubError, match="no such folder"):
        deepkoco.load("nowhere")
    with pytest.raises(ModelFolderError, match=r"config\.json"):
        deepkoco.load(tmp_path / "org" / "name")


def test_without_the_extra_the_hub_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(HubError, match='pip install "huggingface_hub'):
        deepkoco.load("org/name")


def test_a_model_in_the_cache_of_the_hub_is_loaded_through_its_links(folder, tmp_path, monkeypatch):
    pytest.importorskip("huggingface_hub")
    from huggingface_hub import constants

    cache = tmp_path / "hub"
    repository, commit = cache / "models--org--name", "0" * 40
    snapshot = repository / "snapshots" / commit
    snapshot.mkdir(parents=True)
    (repository / "blobs").mkdir()
    (repository / "refs").mkdir()
    (repository / "refs" / "main").write_text(commit)
    for i, file in enumerate(["config.json", "model.safetensors"]):
        (repository / "blobs" / f"{i}").write_bytes((folder / file).read_bytes())
        (snapshot / file).symlink_to(f"../../blobs/{i}")
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(cache))
    found, root = hub.fetch(HubFolder("org/name"))
    assert (found, root) == (snapshot, repository)
    np.testing.assert_array_equal(
        deepkoco.load("hf://org/name").encode(POINT, A), deepkoco.load(folder).encode(POINT, A)
    )
    with pytest.raises(HubError, match="does not give it"):
        deepkoco.load("hf://org/other")
    (snapshot / "config.json").unlink()
    (snapshot / "config.json").symlink_to(folder / "config.json")
    with pytest.raises(ModelFolderError, match="leaves its folder"):
        deepkoco.load("org/name")


def test_runs_of_the_first_version_keep_their_seed(folder):
    config = json.loads((folder / "config.json").read_text())
    for name in ("checksums", "kind", "task", "training"):
        del config[name]
    config |= {"version": 1, "seed": 5, "episodes": 300}
    (folder / "config.json").write_text(json.dumps(config))
    assert deepkoco.load(folder).training == {"seed": 5, "episodes": 300}
