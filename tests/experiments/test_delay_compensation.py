"""The study of delay compensation: what policies see, the unit, tables, a figure."""

import json

import numpy as np
import pytest

from experiments.studies.learning import delay_compensation as study
from experiments.studies.learning import delay_compensation_runs as runs


class Idle:
    """A policy that sends nothing."""

    def act(self, observations):
        return np.zeros((len(observations), 1))


@pytest.mark.parametrize(("name", "entries"), [("full_state", 3), ("stacked", 3 * 6 + 5), ("predicted", 3)])
def test_a_policy_sees_on_the_unit_what_it_sees_in_its_simulation(name, entries):
    envs = runs.make_simulation(runs.METHODS[name], runs.Delays())(2, 0)
    assert envs.single_observation_space.shape == (entries,)


def test_only_the_methods_that_know_the_delays_are_trained_with_them():
    laws = {
        name: runs.make_simulation(method, runs.Delays(0.06, 0.03))(1, 0).settings.sensing_delay
        for name, method in runs.METHODS.items()
    }
    late = {name for name, law in laws.items() if law != 0.0}
    assert late == {"stacked_delays", "filtered", "predicted"}
    assert laws["filtered"]["loc"] == 0.06


@pytest.mark.parametrize("estimator", [None, "predicted"])
def test_a_hanging_pendulum_is_never_upright(estimator, monkeypatch):
    monkeypatch.setattr(runs, "UNIT_STEPS", 40)
    shares = runs.upright_shares(
        Idle(), runs.METHODS["full_state"], estimator, runs.Delays(), [3, 4], "simulated"
    )
    assert len(shares) == 2
    assert max(shares) < 0.6  # falling from wherever it starts, it passes the top at most once


def test_results_become_tables_and_a_figure(tmp_path):
    for seed, share in enumerate((0.9, 1.0)):
        run = {
            "method": "predicted", "seed": seed, "cost": 170.0, "training_cpu_seconds": 20.0,
            "cpu_seconds": 30.0 + seed, "commit": "abc", "options": "", "upright": {"predicted": [share, share]},
            "upright_in_real_time": {"predicted": [0.5] if seed == 0 else []},
        }  # fmt: skip
        (tmp_path / f"predicted_{seed}.json").write_text(json.dumps(run))
    found, shares = study.tables(tmp_path)
    assert shares["upright"].tolist() == [0.9, 0.5, 1.0]
    line = study.summary(found, shares).splitlines()[2]
    # Student's t with one degree of freedom: 12.706 times 0.0707 / sqrt(2), so 95 +- 63.5 %.
    assert line == "| predicted | 95.0 % [31.5, 158.5] | 90.0 % | 50.0 % | 170 | 30 to 31 |"
    assert len(study.draw(shares).axes) == 1
