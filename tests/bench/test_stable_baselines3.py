"""Any other agent trains on the environments: needs the bench extra."""

import warnings

import gymnasium
import pytest

import deepkoco.envs  # noqa: F401 - registers the ids

pytestmark = [pytest.mark.bench, pytest.mark.timeout(900)]
sb3 = pytest.importorskip("stable_baselines3", reason="needs the bench extra: make bench")


@pytest.mark.parametrize("name", ["deepkoco/RodPendulum-v0", "deepkoco/RodPendulumDelay-v0"])
def test_sac_trains_without_a_warning(name: str):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Raised inside torch by any optimiser, whatever the environment.
        warnings.filterwarnings("ignore", category=DeprecationWarning, module="torch")
        model = sb3.SAC("MlpPolicy", gymnasium.make(name), learning_starts=100, seed=0, verbose=0)
        model.learn(2_000)
    assert model.num_timesteps == 2_000
    action, _ = model.predict(model.get_env().reset())
    assert (abs(action) <= 1.0).all()
