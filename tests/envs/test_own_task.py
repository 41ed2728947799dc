"""An environment of a robot and a task of one's own, without registering anything."""

import math
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from scipy.integrate import solve_ivp

import deepkoco
from deepkoco.envs.settings import EnvironmentSettings, SettingsError
from deepkoco.envs.tasks import TASKS, GoalTask, Task, UnknownTaskError, load_task, register_task
from deepkoco.envs.world_rate import slowest_world_rate
from deepkoco.systems import ExtendedSystem, UnknownSystemError, load_system, make_system
from deepkoco.systems.with_speeds import WithSpeeds
from tests.oracle.own_robots import CartPoleUnit

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
CART = f"{EXAMPLES}/cart_pole.py:CartPole"
MJCF = """<mujoco><worldbody><body name="arm"><joint name="shoulder" type="hinge" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02" mass="1"/></body></worldbody>
<actuator><motor name="drive" joint="shoulder" ctrlrange="-3 3"/></actuator></mujoco>"""


class Swing(Task):
    """A task as a user writes it."""

    starts = {"pole": (-0.2, 0.2), "cart": 0.0}  # noqa: RUF012
    limits = {"cart": (-0.3, 0.3)}  # noqa: RUF012
    leaving_cost = 50.0

    def cost(self, scene, state, commands, parameters=None):
        cart, pole, _, _ = state.unbind(-1)
        return cart**2 + 1.0 + torch.cos(pole) + 0.01 * commands[..., 0] ** 2


@pytest.mark.parametrize("executor", ["auto", "eager"])
def test_make_env_steps_a_class_as_an_independent_simulation_and_pays_its_cost(executor):
    envs = deepkoco.make_env(CART, Swing, num_envs=3, executor=executor, world_rate=200.0)
    envs.reset(seed=0, options={"initial_state": [[0.0, 0.1, 0.0, 0.0]] * 3})
    unit, truth = CartPoleUnit(), np.array([0.0, 0.1, 0.0, 0.0])
    for force in (2.0, -3.0, 1.0):
        observation, reward, terminated, truncated, _ = envs.step(np.full((3, 1), force / 10.0, np.float32))
        expected = truth[0] ** 2 + 1.0 + math.cos(truth[1]) + 0.01 * force**2
        assert -reward == pytest.approx(expected, abs=1e-6)
        truth = solve_ivp(lambda _, y, u=force: unit._slope(y, u), (0.0, 0.02), truth, rtol=1e-10).y[:, -1]
        x, c, s, v, w = observation[1]
        assert [x, math.atan2(s, c), v, w] == pytest.approx(truth, abs=1e-5)
        assert not terminated.any()
        assert not truncated.any()


def test_an_episode_ends_where_the_state_leaves_the_limits_and_pays_for_it_once():
    envs = deepkoco.make_env(CART, Swing, num_envs=2, autoreset_mode="Disabled")
    envs.reset(seed=1)
    full = np.array([[1.0], [0.0]], np.float32)
    costs, steps = [], 0
    terminated = np.zeros(2, bool)
    while not terminated.any():
        observation, reward, terminated, _, _ = envs.step(full)
        costs.append(-reward)
        steps += 1
        assert steps < 100
    assert terminated.tolist() == [True, False]
    assert observation[0, 0] > 0.3
    assert costs[-1][0] > 50.0 > 10.0 > costs[-2][0]
    assert costs[-1][1] < 10.0


def test_make_env_of_one_environment_passes_the_check_of_gymnasium():
    env = deepkoco.make_env(CART, Swing, max_episode_steps=30, render_mode="rgb_array", noise=True)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=0)
    for _ in range(30):
        *_, terminated, truncated, _ = env.step(np.zeros(1, np.float32))
    assert (terminated, truncated) == (False, True)
    picture = env.render()
    assert picture.shape == (256, 256, 3)
    assert env.unwrapped.spec is None or isinstance(env, gymnasium.Env)


def test_start_states_lie_in_the_ranges_of_the_task():
    scene = WithSpeeds(load_system(CART), 50.0)
    start = Swing().on(scene).start(scene, 500, torch.Generator().manual_seed(0))
    assert start.shape == (500, 4)
    assert start[:, [0, 2, 3]].abs().max() == 0.0
    assert 0.19 < start[:, 1].max() <= 0.2
    assert -0.2 <= start[:, 1].min() < -0.19


def test_goal_task_costs_nothing_at_the_goal_and_one_a_radian_from_it():
    arm = make_system("two_link_arm")
    names = arm.state_names
    task = GoalTask({names[0]: 1.0, names[1]: -0.5}).on(arm)
    states = torch.tensor(
        [[1.0, -0.5, 0, 0], [2.0, 0.5, 0, 0], [1.0 + 2 * math.pi, -0.5, 0, 0]], dtype=torch.float64
    )
    cost = task.cost(arm, states, torch.zeros(3, 2, dtype=torch.float64))
    assert cost.tolist() == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    full = torch.tensor([c.high for c in arm.commands], dtype=torch.float64)
    assert float(task.cost(arm, states[0], full)) == pytest.approx(0.01)


def test_the_name_of_a_joint_stands_for_its_position(tmp_path):
    (tmp_path / "arm.xml").write_text(MJCF)
    arm = load_system(tmp_path / "arm.xml")
    joint, position = arm.joint_names[0], arm.state_names[0]
    assert joint != position
    ranges = {joint: (-0.5, 0.5)}
    task = GoalTask({joint: 0.4}, starts=ranges, limits=ranges).on(arm)
    assert (task.goal, task.starts, task.limits) == (
        {position: 0.4},
        {position: (-0.5, 0.5)},
        {position: (-0.5, 0.5)},
    )


def test_make_env_needs_no_task(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(MJCF)
    envs = deepkoco.make_env(tmp_path / "arm.xml", num_envs=2)
    observation, _ = envs.reset(seed=0)
    assert observation.shape == (2, 3)
    assert isinstance(envs.task, GoalTask)
    _, reward, _, _, _ = envs.step(np.zeros((2, 1), np.float32))
    assert (reward < 0.0).all()


def test_make_env_simulates_the_delay_of_a_model_and_draws_its_parameters(tmp_path):
    deepkoco.systems.save_model(
        tmp_path / "model.yaml",
        ExtendedSystem(load_system(CART), ("actuation_delay(cart)",), {"actuation_delay(cart).delay": 0.06}),
    )
    late = deepkoco.make_env(tmp_path / "model.yaml", Swing, num_envs=1)
    start = {"initial_state": [[0.0, 0.0, 0.0, 0.0]]}
    late.reset(seed=0, options=start)
    moved = [late.step(np.ones((1, 1), np.float32))[0][0, 0] for _ in range(5)]
    assert max(np.abs(moved[:3])) < 1e-9 < 1e-4 < moved[4]
    drawn = deepkoco.make_env(CART, Swing, num_envs=50, randomize={"pole_mass": (0.1, 0.4)})
    drawn.reset(seed=0)
    assert np.ptp(drawn.drawn["pole_mass"]) > 0.2


def test_the_world_rate_is_chosen_for_stiff_robots():
    belt = load_system(f"{EXAMPLES}/motor.py:BeltMotor")
    assert slowest_world_rate(load_system(CART), 50.0) == 100.0
    stiff = ExtendedSystem(belt, (), {"stiffness": 90.0})
    rate = slowest_world_rate(stiff, 50.0)
    omega = math.sqrt(90.0 * (1 / 5e-5 + 1 / 1.5e-4))
    assert omega / 1.4 <= rate < omega / 1.4 * 1.3
    envs = deepkoco.make_env(stiff, num_envs=2)
    envs.reset(seed=0)
    for _ in range(20):
        observation, *_ = envs.step(np.ones((2, 1), np.float32))
    assert np.isfinite(observation).all()


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    source = "from deepkoco import Task\nclass Stay(Task):\n    control_rate = 25.0\n"
    source += (
        "    def cost(self, scene, state, commands, parameters=None):\n        return state[..., 0] ** 2\n"
    )
    (tmp_path / "my_task.py").write_text(source)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    return tmp_path


@pytest.mark.parametrize("text", ["my_task.py:Stay", "my_task:Stay", "my_task.py"])
def test_tasks_are_found_by_file_and_module(here, text):
    assert type(load_task(text)).__name__ == "Stay"
    env = gymnasium.make("deepkoco/Robot-v0", system=CART, task=text)
    assert env.unwrapped.dt == pytest.approx(0.04)


def test_a_registered_task_has_a_name():
    try:
        register_task(Swing)
        register_task(GoalTask({"pole": math.pi}), "up")
        assert type(load_task("Swing")) is Swing
        assert load_task("up").goal == {"pole": math.pi}
        with pytest.raises(UnknownTaskError, match='there is a task "up" already'):
            register_task(Swing, "up")
    finally:
        TASKS.pop("Swing", None)
        TASKS.pop("up", None)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"task": "my_tsk.py:Stay"}, r"task: .*there is no file my_tsk\.py"),
        ({"task": "swim"}, "unknown task .*one of your own: my_task.py:CLASS"),
        ({"task": {"pol": 1.0}}, 'goal names "pol"; the positions of cart_pole are cart, pole'),
        ({"task": type("T", (Swing,), {"limits": {"rail": (-1, 1)}})}, 'limits names "rail"; the states .* cart, pole'),
        ({"task": type("T", (Swing,), {"starts": {"pole": (1, 0)}})}, r"starts: pole = \(1, 0\); give \(low, high\)"),
        ({"task": type("T", (Swing,), {"system": "pendulum"})}, "is one of pendulum, not of cart_pole"),
        ({"task": 3}, "3 is no Task"),
        ({"system": None}, "system is not given"),
    ],
)  # fmt: skip
def test_wrong_tasks_are_told(settings, said):
    with pytest.raises(SettingsError, match=said):
        EnvironmentSettings(**{"system": CART, **settings})


def test_an_unknown_robot_is_told():
    with pytest.raises(UnknownSystemError, match="no file my_robt"):
        deepkoco.make_env("my_robt.py:Cart")
