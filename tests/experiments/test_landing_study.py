"""The study of landings: its unit against the simulator, what trainings know, tables, maps and film."""

import json

import numpy as np
import pytest
import torch

from deepkoco.envs.landing import landing_start
from deepkoco.envs.landing.landing_env import LandingVectorEnv
from deepkoco.systems import make_system
from experiments.studies.learning import landing_runs as runs
from experiments.studies.learning import landing_study as study
from experiments.studies.learning import landing_unit
from experiments.studies.learning.landing_unit import LandingUnits

NOMINAL = {p.name: p.value for p in make_system("quadrotor").parameters}


def tensor(values) -> torch.Tensor:
    return torch.tensor(np.array(values), dtype=torch.float64)


def test_a_unit_lands_as_the_simulator_does(monkeypatch):
    """Two codes: bodies fall past or onto decks that drive straight on; what is seen and the touch-down agree."""
    for name in ("LATENESS", "TURN_SPREAD"):
        monkeypatch.setattr(landing_unit, name, 0.0)
    monkeypatch.setattr(landing_unit, "DECK_NOISE", np.zeros(9))
    monkeypatch.setattr("experiments.studies.learning.quadrotor_flight.NOISE", np.zeros(6))
    incline, speed = np.radians([0.0, 20.0, 10.0]), np.array([0.0, 0.5, 1.0])
    unit = LandingUnits(NOMINAL, incline, speed, deck_delay=0.05, action_history=2)
    unit.reset(seed=0)
    unit._flight._jitter = 0.0
    headings, slopes = unit._heading.copy(), unit._slope.copy()
    # Over the middle, 5 cm beside it, and out of its reach.
    body = np.array([[0.0, 0.0, 0.3], [0.05, 0.0, 0.3], [0.8, 0.0, 0.3]])
    velocity = np.stack([speed * np.cos(headings), speed * np.sin(headings), 0.0 * speed], 1)
    unit._flight.state = np.concatenate([body, velocity], 1)
    unit._height = unit._against()[0]

    envs = LandingVectorEnv(
        3, executor="eager", noise=False, action_history=2, deck_delay=0.05, autoreset_mode="NextStep"
    )
    start = landing_start(tensor(incline), tensor(speed), torch.Generator(), tensor(unit._flight.state))
    start["deck"] |= {"heading": tensor(headings), "slope": tensor(slopes), "swing": tensor(np.zeros(3))}
    still = {"turn_spread": torch.tensor(0.0, dtype=torch.float64)}
    monkeypatch.setattr(
        "deepkoco.engines.landing.deck.deck_parameters", lambda: still | {"turn_time": tensor(1.0)}
    )
    envs._randomization._values["deck"] = still
    envs.reset(seed=0, options={"initial": start})
    rng, touched = np.random.default_rng(3), {}
    for step in range(30):
        actions = np.clip(rng.normal([-0.3, 0.0, 0.0], 0.1, (3, 3)), -1.0, 1.0).astype(np.float32)
        seen, _, ended, _, info = unit.step(actions)
        expected, _, ends, _, told = envs.step(actions)
        if step == 8:
            np.testing.assert_allclose(seen, expected, atol=0.02)
        for k in np.flatnonzero(ends & told["touched"]):
            touched.setdefault(k, (step, [told[n][k] for n in runs.TOLD], bool(told["success"][k])))
        if ends[:2].all():
            break
    assert set(touched) == {0, 1}
    for k, (_, values, success) in touched.items():
        assert bool(ended[k])
        np.testing.assert_allclose([info[n][k] for n in runs.TOLD], values, atol=0.03)
        assert bool(info["success"][k]) is success


def test_only_one_of_the_trainings_knows_the_delays():
    values = {**NOMINAL, "roll_delay": 0.1}
    ranges = {m: runs.make_simulation(m, values)(1, 0)._randomization.ranges for m in runs.METHODS}
    assert ranges["without"]["world.roll_delay"] == (0.0, 0.0)
    assert ranges["delays"]["world.roll_delay"] == pytest.approx((0.094, 0.106))
    assert ranges["delays"]["deck_sensor->agent"] == pytest.approx((0.08, 0.12))
    assert "deck_sensor->agent" not in ranges["without"]
    assert ranges["without"]["world.mass"] == ranges["delays"]["world.mass"]


def test_a_level_controller_lands_on_a_level_deck_at_rest():
    rows, steps = runs.land(runs.LevelLanding(NOMINAL["mass"]), NOMINAL, 0.02, [(0.0, 0.0)] * 8, 0)
    assert np.mean([row["success"] for row in rows]) >= 0.75
    assert {"place", "deck", "normal", "axis", "touched"} == set(steps[0])


def test_a_level_controller_does_not_land_on_a_steep_deck():
    rows, _ = runs.land(runs.LevelLanding(NOMINAL["mass"]), NOMINAL, 0.02, [(np.radians(25.0), 0.0)] * 8, 0)
    assert not any(row["success"] for row in rows)


def test_a_guided_landing_reaches_the_attitude_of_a_steep_moving_deck():
    cells = [(np.radians(25.0), 0.5)] * 10
    controller = runs.by_hand("guided_delays", NOMINAL)
    rows, _ = runs.land(controller, NOMINAL, 0.1, cells, 0)
    assert np.mean([row["success"] for row in rows]) >= 0.6


def test_a_guided_landing_that_knows_no_delay_follows_the_deck_from_behind():
    """1 m/s and 0.1 s: it comes down 0.1 m behind the centre."""
    cells = [(0.0, 1.0)] * 10
    unaware, _ = runs.land(runs.by_hand("guided_without", NOMINAL), NOMINAL, 0.1, cells, 0)
    aware, _ = runs.land(runs.by_hand("guided_delays", NOMINAL), NOMINAL, 0.1, cells, 0)
    offsets = [np.median([row["offset"] for row in rows if row["touched"]]) for rows in (unaware, aware)]
    assert offsets[0] == pytest.approx(0.1, abs=0.05)
    assert offsets[1] < 0.5 * offsets[0]


def stored_run(kind: str, seed: int) -> dict:
    cells = [(i, v) for i in (0.0, np.radians(25.0)) for v in (0.0, 1.0)]
    one = {"touched": True, "time": 1.0, "offset": 0.1, "sink": 0.3, "slip": 0.2, "tilt": 0.1}
    landings = [
        {"incline": i, "speed": v, "success": kind == "delays", **one} for i, v in cells for _ in range(2)
    ]
    steps, decks = 6, len(runs.FILMED)
    film = {
        "place": np.tile([0.0, 0.0, 0.4], (steps, decks, 1)).tolist(),
        "deck": np.zeros((steps, decks, 3)).tolist(),
        "normal": np.tile([0.0, 0.0, 1.0], (steps, decks, 1)).tolist(),
        "axis": np.tile([0.0, 0.1, 0.995], (steps, decks, 1)).tolist(),
        "touched": np.repeat([[0.0], [0.0], [0.0], [0.0], [1.0], [1.0]], decks, 1).tolist(),
    }
    training = {"cost": 8.0, "steps": 10, "cpu_seconds": 40.0 + seed}
    return {
        "method": kind, "seed": seed, "fit_cpu_seconds": 1.0, "cpu_seconds": 50.0, "commit": "abc",
        "ways": {method: {"landings": landings, "training": training, "film": film} for method in runs.KINDS[kind]},
    }  # fmt: skip


def test_results_become_tables_maps_and_a_film(tmp_path):
    for kind in ("by_hand", "delays"):  # a study of some of the ways
        for seed in (0, 1):
            (tmp_path / f"{kind}_{seed}.json").write_text(json.dumps(stored_run(kind, seed)))
    found, landings = study.tables(tmp_path)
    cells = study.success_map(landings)
    steep = cells[(cells["method"] == "delays") & (cells["incline_deg"] == 25.0) & (cells["speed"] == 1.0)]
    # Four of four: Wilson's interval begins at 4 / (4 + 1.96^2).
    assert float(steep["low"].iloc[0]) == pytest.approx(4.0 / (4.0 + 1.96**2), abs=1e-3)
    text = study.summary(found, landings)
    assert "| trained with delays | 1.00 [0.81, 1.00], seeds 1.00 to 1.00 |" in text
    assert "delays: 40 to 41 processor seconds a training" in text
    assert len(study.draw_maps(cells).axes) == 5
    films = study.films_of(tmp_path, 0)
    assert len(study.draw_strip(films, 2).axes) == 4 * study.SHOWN
    assert study.frames(films)[0].shape == (4 * study.SIZE, 3 * study.SIZE, 3)
