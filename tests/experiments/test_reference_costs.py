"""Optimum and random policy on the start states of runs."""

import numpy as np
import pandas as pd

from deepkoco.agent.collection import collect_episodes, episode_costs
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.runs.environments import make_factory
from experiments import optimum
from experiments.comparison.references import REFERENCES, load_references
from experiments.optimum import load_task
from experiments.reference_costs import main


class Idle:
    """No torque."""

    def __init__(self, count: int) -> None:
        self.count = count

    def reset(self) -> None:
        """Nothing to reset."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        return np.zeros((self.count, 1))


def test_start_states_are_those_that_training_evaluates_on():
    task = load_task("pendulum").task
    known = load_references(task)
    assert known is not None
    assert 90.0 < known.optimum_without_delay < known.optimum < known.random
    costs = {}
    for count in (3, 10):
        envs = make_factory(task, "copies")(count, 2)
        seed = derive_seed(2, Purpose.EVALUATION)
        costs[count] = episode_costs(collect_episodes(envs, Idle(count), seed, record=False))
        envs.close()
    # The first start states are the same however many there are, and whatever the distractors.
    np.testing.assert_allclose(costs[3], costs[10][:3])
    own = known.table[(known.table["seed"] == 2) & (known.table["purpose"] == "evaluation")]
    best = own["optimum"].to_numpy()[:10]
    assert (best <= costs[10] + 1.0).all()
    # From where a pendulum that is left alone pays least, the best controller does too.
    assert np.corrcoef(best, costs[10])[0, 1] > 0.5


def test_all_stored_references_belong_to_tasks():
    names = [path.stem for path in REFERENCES.glob("*.csv")]
    assert names
    for name in names:
        assert load_references(load_task(name).task) is not None


def test_a_file_is_written_once_and_bad_arguments_are_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(optimum, "GRIDS", ((101, 15),))  # quicker, and less exact
    call = ["--task", "pendulum", "--seeds", "3", "--episodes", "2", "--out", str(tmp_path)]
    assert main(call) == 0
    assert "value iteration" in capsys.readouterr().out
    ours = pd.read_csv(tmp_path / "pendulum.csv")
    stored = pd.read_csv(REFERENCES / "pendulum.csv")
    same = stored[(stored["seed"] == 3) & (stored["purpose"] == "evaluation") & (stored["episode"] < 2)]
    # The same start states: on a coarser grid no better, and nowhere near no action.
    excess = ours["optimum"].to_numpy() - same["optimum"].to_numpy()
    assert len(excess) == 2
    assert ((excess > -1.0) & (excess < 150.0)).all()
    assert main(call) == 2
    assert "exists already" in capsys.readouterr().err
    assert main(["--task", "pendulum_delay", "--out", str(tmp_path)]) == 2
    assert "--task pendulum_delay" in capsys.readouterr().err
    assert main(["--task", "pendulum", "--episodes", "0", "--out", str(tmp_path / "x")]) == 2
