"""The study of circle following: its unit against the simulator, what trainings know, tables and figures."""

import json

import numpy as np
import pytest

from deepkoco.envs.delay_env import DelayGraphVectorEnv
from deepkoco.systems import make_system
from experiments.studies.learning import circle_runs as runs
from experiments.studies.learning import circle_study as study
from experiments.studies.learning.circle_unit import SIMULATION, QuadrotorUnits

NOMINAL = {p.name: p.value for p in make_system("quadrotor").parameters}
CIRCLES = [(0.5, 1.0), (1.0, 0.8)]


def test_a_unit_flies_as_the_simulator_does(monkeypatch):
    """Two codes: steps of 1 ms with a middle, and Runge-Kutta over ticks with mean commands."""
    monkeypatch.setattr("experiments.studies.learning.circle_unit.JITTER", 0.0)
    unit = QuadrotorUnits(NOMINAL, CIRCLES, action_history=2)
    simulation = DelayGraphVectorEnv(2, 60, action_history=2, executor="eager", **SIMULATION)
    seen, _ = unit.reset(seed=0)
    start = np.array([[r, 0.0, 0.0, 0.0, 0.0, 0.0, r, v] for r, v in CIRCLES])
    expected, _ = simulation.reset(seed=0, options={"initial_state": start})
    np.testing.assert_allclose(seen[:, 10:], expected[:, 10:], atol=1e-6)
    rng = np.random.default_rng(2)
    for _ in range(50):
        actions = np.clip(rng.normal(0.0, 0.3, (2, 3)), -1.0, 1.0).astype(np.float32)
        seen, _, _, _, info = unit.step(actions)
        expected, *_ = simulation.step(actions)
    truth = simulation.state.nodes["agent"]["truth"][:, :3].numpy()
    assert np.abs(truth - start[:, :3]).max() > 0.3  # it has gone somewhere
    np.testing.assert_allclose(info["place"], truth, atol=0.01)
    np.testing.assert_allclose(seen[:, 10:], expected[:, 10:], atol=1e-6)


def test_a_unit_tells_its_true_distance_from_the_circle():
    unit = QuadrotorUnits({**NOMINAL, "mass": 0.03}, CIRCLES)
    unit.reset(seed=0)
    unit._flight.state[:, 2] = 0.3
    unit._flight.state[:, 0] += 0.4
    assert unit._info()["path_error"] == pytest.approx([0.5, 0.5])


def test_only_one_of_the_trainings_knows_the_delays():
    values = {**NOMINAL, "roll_delay": 0.1}
    ranges = {m: runs.make_simulation(m, values)(1, 0).settings.randomize for m in runs.METHODS}
    assert ranges["without"]["roll_delay"] == (0.0, 0.0)
    assert ranges["delays"]["roll_delay"] == pytest.approx((0.094, 0.106))
    assert (
        ranges["without"]["mass"] == ranges["delays"]["mass"] == pytest.approx((0.95 * 0.033, 1.05 * 0.033))
    )


def test_a_further_delay_leaves_all_else_of_a_unit():
    near, far = runs.make_unit(3, 0.0), runs.make_unit(3, 0.08)
    assert {n for n in near if near[n] != far[n]} == {"thrust_delay", "roll_delay", "pitch_delay"}
    assert far["roll_delay"] - near["roll_delay"] == pytest.approx(0.08)


class Idle:
    """A policy that holds the middle of all commands."""

    def act(self, observations):
        return np.zeros((len(observations), 3))


@pytest.mark.parametrize("model", [None, NOMINAL])
def test_flights_are_measured_by_radius(model, monkeypatch):
    for name, value in (("FLIGHTS", 1), ("FLIGHT_STEPS", 6), ("SETTLED", 2)):
        monkeypatch.setattr(runs, name, value)
    errors, places = runs.fly(Idle(), runs.make_unit(0, 0.08), model, 1)
    assert list(errors) == ["0.25", "0.5", "1"]
    assert places.shape == (6, 3, 3)


def stored_run(seed):
    flights = [
        {
            "method": method, "further_delay": further, "predicted": predicted,
            "errors": {"0.25": [error], "0.5": [error, error], "1": [error]},
            "places": [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0]] if further == study.FURTHER else None,
        }
        for method, error in (("without", 0.13), ("delays", 0.02))
        for further, predicted in ((0.0, False), (study.FURTHER, False), (study.FURTHER, True))
        if method == "without" or not predicted
    ]  # fmt: skip
    trainings = {method: {"cost": 8.0, "cpu_seconds": 40.0 + seed} for method in runs.METHODS}
    return {
        "seed": seed, "fit_cpu_seconds": 1.0, "cpu_seconds": 50.0, "commit": "abc", "flights": flights,
        "trainings": trainings,
    }  # fmt: skip


def test_results_become_tables_and_figures(tmp_path):
    for seed in (0, 1):
        (tmp_path / f"unit_{seed}.json").write_text(json.dumps(stored_run(seed)))
    found, errors = study.tables(tmp_path)
    text = study.summary(found, errors)
    assert "| trained with the identified delays | 80 ms | 0.020 m [0.020, 0.020] |" in text
    assert "at 0.5 m: 6.5 to 6.5, at least 3 in 2 of 2 seeds" in text
    assert "delays: 40 to 41 processor seconds a training" in text
    assert set(errors["label"]) == {"without", "predicted", "delays"}
    assert len(study.draw(errors).axes) == 3
    assert len(study.draw_flights(tmp_path, 0).axes) == 3
