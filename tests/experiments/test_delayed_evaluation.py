"""Evaluation among delays: what is bridged, what is refused, what is stored with a run."""

import json
import multiprocessing
import shutil
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from deepkoco.agent.collection import collect_episodes, episode_costs
from deepkoco.agent.forward_fit import ForwardFitConfig
from deepkoco.agent.replay_files import write_replay
from deepkoco.cli.command_line import main
from deepkoco.runs.delayed import FORWARD_FOLDER, add_delays, forward_model_of, load_delayed_agent
from deepkoco.runs.environments import make_environments
from deepkoco.runs.evaluate import run_episodes
from deepkoco.runs.settings import EvaluateConfig, ExperimentError
from deepkoco.runs.train import load_run_config


class Random:
    """Uniform torques, drawn from a seed."""

    def __init__(self, count):
        self.count = count

    def reset(self):
        self.rng = np.random.default_rng(0)

    def act(self, observations):
        return self.rng.uniform(-2.0, 2.0, (self.count, 1))


@pytest.fixture(scope="module")
def run(make_run, tmp_path_factory):
    """A run with random weights and a few random episodes in its replay."""
    folder = make_run(tmp_path_factory.mktemp("runs") / "run")
    envs = make_environments(load_run_config(folder))(6, 0)
    write_replay(folder, 0, collect_episodes(envs, Random(6), 1))
    forward_model_of(folder, 0.05, 0, ForwardFitConfig((8,), updates=50))
    return folder


def costs(run, **settings):
    return run_episodes(EvaluateConfig(str(run), episodes=3, **settings)).costs


def test_without_delays_compensation_changes_no_bit(run):
    plain = costs(run)
    for compensate in ("measured", "law", "both"):
        for roll in ("observation", "latent"):
            assert np.array_equal(costs(run, compensate=compensate, roll=roll), plain)


def test_a_forward_model_is_fitted_once_and_kept_with_the_run(run):
    assert (run / FORWARD_FOLDER / "model.safetensors").is_file()
    delays = {"sensing_delay": 0.1, "actuation_delay": {"law": "uniform", "low": 0.0, "high": 0.1}}
    first = costs(run, compensate="measured", **delays)
    files = {path: path.stat().st_mtime_ns for path in (run / FORWARD_FOLDER).iterdir()}
    assert np.array_equal(costs(run, compensate="measured", **delays), first)
    assert {path: path.stat().st_mtime_ns for path in (run / FORWARD_FOLDER).iterdir()} == files
    assert not np.array_equal(costs(run, **delays), first)


def test_constant_delays_need_no_time_stamps(run):
    told, knowing = (costs(run, sensing_delay=0.1, compensate=c, roll="latent") for c in ("measured", "law"))
    # At the first steps the age of the observation is below the expected one, which is cut at the start.
    np.testing.assert_allclose(told, knowing, rtol=1e-9)


def test_the_weight_of_increments_is_that_of_the_evaluation(run):
    calm = costs(run, sensing_delay=0.1, compensate="law", increment_weight=1e6)
    envs = add_delays(make_environments(load_run_config(run))(2, 0), 0.1, 0.0)
    agent = load_delayed_agent(run, envs, "law", "observation", 0, 1e6)
    agent.reset()
    observation, info = envs.reset(seed=0)
    agent.note(info)
    agent.act(observation)
    assert np.abs(agent.act(observation)).max() < 1e-3
    assert np.isfinite(calm).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"compensate": "yes"}, "choose one of none, measured, law, both"),
        ({"roll": "cost"}, "choose one of observation, latent"),
        ({"sensing_delay": -0.1}, "sensing_delay"),
        ({"actuation_delay": {"law": "unifrom"}}, "actuation_delay"),
        ({"sensing_delay": {"0": 0.1}, "compensate": "law"}, "one delay for the whole observation"),
    ],
)
def test_wrong_settings_are_refused(run, settings, message):
    with pytest.raises(ExperimentError, match=message):
        costs(run, **settings)


def test_a_run_without_episodes_says_what_to_do(make_run, tmp_path):
    bare = make_run(tmp_path / "bare")
    with pytest.raises(ExperimentError, match="roll=latent"):
        costs(bare, sensing_delay=0.1, compensate="law")
    assert np.isfinite(costs(bare, sensing_delay=0.1, compensate="law", roll="latent")).all()


def test_the_command_takes_laws(run, capsys):
    law = "{law:uniform,low:0.0,high:0.1}"
    assert main(["evaluate", str(run), f"sensing_delay={law}", "in_order=false", "compensate=measured", "episodes=2",
                 "json=true"]) == 0  # fmt: skip
    assert json.loads(capsys.readouterr().out)["n"] == 2


def test_delays_make_episodes_of_the_same_start_states(run):
    """The true cost of the first step is that of the start, whatever the delays."""
    config = load_run_config(run)
    firsts = []
    for delay in (0.0, 0.2):
        envs = add_delays(make_environments(config)(4, 0), delay, delay)
        firsts.append([e.costs[0].item() for e in collect_episodes(envs, Random(4), 7)])
    assert len(set(np.round(firsts[0], 6))) == 4
    # Torques differ from the first step on; they cost 0.001 of their square, at most 0.004.
    np.testing.assert_allclose(firsts[0], firsts[1], atol=0.005)
    assert episode_costs(collect_episodes(envs, Random(4), 7)).shape == (4,)


def _fit(folder):
    return forward_model_of(folder, 0.05, 0, ForwardFitConfig((8,), updates=200)).layers


def test_two_evaluations_that_fit_a_forward_model_at_once_get_the_same_one(run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(run, folder, ignore=shutil.ignore_patterns(FORWARD_FOLDER))
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork")) as pool:
        first, second = pool.map(_fit, [folder, folder])
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
