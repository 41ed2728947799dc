"""MJCF objects as engine nodes: MuJoCo stepped by hand is the oracle."""

import pickle

import gymnasium
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.engines import EngineError, MjcfObject, MujocoEngine, Scene, make_graph, parameter_values
from deepkoco.engines.hold import means_within_tick
from deepkoco.engines.model_parameters import changed_model
from deepkoco.envs.engine_env import EngineEnv
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.fit.graph_fit import fit_replay
from deepkoco.graph import (
    BatchedRuntime,
    Connection,
    Input,
    Node,
    Supervisor,
    draw_timing,
    drop_nodes,
    record_episodes,
    replay_record,
)

mujoco = pytest.importorskip("mujoco")
F64 = torch.float64

ARM = """
<mujoco model="arm">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.3"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
      <body name="fore" pos="0.3 0 0"><joint name="elbow" axis="0 1 0" damping="0.2"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="0.5"/><site name="tip" pos="0.25 0 0"/></body>
    </body>
  </worldbody>
  <actuator><position name="shoulder_goal" joint="shoulder" kp="20" ctrlrange="-2 2"/>
    <motor name="elbow_torque" joint="elbow" gear="2"/></actuator>
  <sensor><framepos name="tip" objtype="site" objname="tip"/><gyro name="gyro" site="tip" noise="0.1"/></sensor>
  <keyframe><key name="bent" qpos="0.5 -1"/></keyframe>
</mujoco>"""
PUSHER = """
<mujoco model="pusher"><worldbody><body name="hand" pos="0 0 0.1">
  <joint name="push" type="slide" axis="1 0 0" damping="1"/><geom name="palm" type="box" size="0.05 0.1 0.05" mass="1"/>
</body></worldbody><actuator><motor name="force" joint="push"/></actuator></mujoco>"""
BOX = """
<mujoco model="box"><worldbody><body name="box" pos="0 0 0.1">
  <joint name="slide" type="slide" axis="1 0 0" damping="0.1"/><geom type="box" size="0.05 0.05 0.05" mass="0.3"/>
</body></worldbody></mujoco>"""


class Looker(Supervisor):
    """Shows what it sees last."""

    def observe(self, parameters, state, inputs, action):
        return state, {name: seen.data[:, -1] for name, seen in inputs.items()}


def run(graph, actions, parameters=None, batch=1, generator=0):
    """Readings (steps, B, ...) of given actions (steps, B, M)."""
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), len(actions), batch))
    state, _ = runtime.reset({"world": parameters or {}}, torch.Generator().manual_seed(generator))
    return runtime.rollout(state, actions)[1]


def looker(actuators: int) -> Looker:
    return Looker("agent", 20, initial_action=torch.zeros(actuators, dtype=F64))


def by_hand(model, actions, delay_steps: int, start=None):
    """Positions, speeds and tip at each step of a 20 Hz agent but the first, stepped with held commands."""
    data = mujoco.MjData(model)
    if start is not None:
        data.qpos[:], data.qvel[:] = start[: model.nq], start[model.nq :]
    each = round(0.05 / model.opt.timestep)
    seen = []
    for k in range(len(actions) * each):
        newest = (k - delay_steps) // each
        data.ctrl[:] = actions[newest] if newest >= 0 else 0.0
        data.ctrl[0] = np.clip(data.ctrl[0], -2.0, 2.0)
        mujoco.mj_step(model, data)
        if (k + 1) % each == 0:
            mujoco.mj_forward(model, data)
            seen.append(np.concatenate([data.qpos, data.qvel, data.sensor("tip").data]))
    return np.array(seen)


@settings(max_examples=8, deadline=None)
@given(delay_steps=st.integers(0, 40), seed=st.integers(0, 100), threads=st.sampled_from([0, 2]))
def test_a_batch_moves_as_mujoco_stepped_by_hand_at_any_delay(delay_steps, seed, threads):
    start = torch.tensor([0.4, -0.8, 0.0, 1.0], dtype=F64)
    graph = make_graph(
        MjcfObject(ARM, measured=("q_shoulder", "q_elbow", "dq_shoulder", "dq_elbow", "tip")),
        MujocoEngine(threads=threads),
        agent=looker(2),
        actuation_delay=delay_steps * 0.002,
    )
    actions = torch.randn(12, 3, 2, generator=torch.Generator().manual_seed(seed), dtype=F64)
    seen = run(graph, actions, {"start": start[None]}, batch=3)["sensor"].numpy()
    for b in range(3):
        expected = by_hand(MjcfObject(ARM).compile(), actions[:, b].numpy(), delay_steps, start.numpy())
        np.testing.assert_allclose(seen[:, b], expected, atol=1e-9)


def test_each_environment_can_have_parameters_of_its_own():
    names = {"mass(fore)": [0.5, 0.9], "damping(elbow)": [0.2, 0.5], "kp(shoulder_goal)": [20.0, 30.0]}
    graph = make_graph(MjcfObject(ARM), "mujoco", agent=looker(2))
    actions = torch.randn(10, 2, 2, generator=torch.Generator().manual_seed(1), dtype=F64)
    seen = run(graph, actions, {k: torch.tensor(v, dtype=F64) for k, v in names.items()}, batch=2)[
        "truth"
    ].numpy()
    for b in range(2):
        model = changed_model(MjcfObject(ARM).compile(), {name: values[b] for name, values in names.items()})
        assert parameter_values(model).items() >= {name: values[b] for name, values in names.items()}.items()
        np.testing.assert_allclose(seen[:, b, :4], by_hand(model, actions[:, b].numpy(), 0)[:, :4], atol=1e-9)
    with pytest.raises(Exception, match=r'no parameter "mass\(forearm\)"; did you mean mass\(fore\)'):
        run(graph, actions, {"mass(forearm)": torch.tensor(1.0)}, batch=2)


def test_an_object_names_its_joints_actuators_and_sensors(tmp_path):
    arm = MjcfObject(ARM, keyframe="bent")
    assert [(c.name, c.unit, c.high) for c in arm.actuators] == [
        ("shoulder_goal", "rad", 2.0),
        ("elbow_torque", "N m", np.inf),
    ]
    names = [c.name for c in arm.sensors]
    assert names[:4] == ["q_shoulder", "q_elbow", "dq_shoulder", "dq_elbow"]
    assert names[4:] == ["tip[0]", "tip[1]", "tip[2]", "gyro[0]", "gyro[1]", "gyro[2]"]
    assert arm.scene.start.tolist() == [0.5, -1.0, 0.0, 0.0]
    urdf = tmp_path / "link.urdf"
    urdf.write_text(
        '<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" '
        'izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="turn" type="continuous"><parent link="base"/>'
        '<child link="arm"/><axis xyz="0 0 1"/></joint></robot>'
    )
    assert [(c.name, c.unit) for c in MjcfObject(urdf).actuators] == [("turn", "N m")]


def test_noise_is_that_of_the_channels_and_of_the_seed():
    clean, noisy, again = (
        run(
            make_graph(MjcfObject(ARM, ("gyro",)), MujocoEngine(noise=n), agent=looker(2)),
            torch.zeros(200, 4, 2),
            batch=4,
        )
        for n in (False, True, True)
    )
    assert (noisy["sensor"] == again["sensor"]).all()
    assert float((noisy["sensor"] - clean["sensor"]).std()) == pytest.approx(0.1, rel=0.1)


def test_an_environment_that_diverges_is_nan_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log where it is
    graph = make_graph(MjcfObject(ARM), "mujoco", agent=looker(2))
    actions = torch.zeros(5, 2, 2, dtype=F64)
    actions[2, 0, 1] = np.nan
    seen = run(graph, actions, batch=2)["truth"]
    assert torch.isfinite(seen[:, 1]).all()
    assert torch.isnan(seen[3:, 0]).all()
    assert (seen[:, 1] == run(graph, torch.zeros(5, 1, 2, dtype=F64))["truth"][:, 0]).all()


def two_objects(**options):
    objects = {"hand": MjcfObject(PUSHER), "box": MjcfObject(BOX, position=(0.3, 0.0, 0.0))}
    return make_graph(objects, "mujoco", agent=looker(1), **options)


def test_objects_in_one_scene_touch_each_other_and_start_each_on_its_own():
    graph = two_objects()
    assert set(graph.index) == {"world", "hand_sensor", "box_sensor", "agent"}
    push = torch.full((40, 2, 1), 2.0, dtype=F64)
    starts = {"start(hand)": torch.tensor([[0.0, 0.0], [-5.0, 0.0]], dtype=F64)}
    seen = run(graph, push, starts, batch=2)
    box, hand = seen["box_sensor"], seen["hand_sensor"]
    assert box[-1, 0, 0] > 0.2  # pushed
    assert box[-1, 1, 0] == 0.0  # the hand started too far away
    assert (hand[:, 0, 0] < box[:, 0, 0] + 0.2 + 1e-2).all()  # it does not go through


def test_two_arms_take_their_entries_of_the_action_on_every_engine(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.replace("implicitfast", "RK4"))
    objects = {"left": path, "right": MjcfObject(path, position=(0.0, 1.0, 0.0))}  # side by side
    actions = 0.5 * torch.randn(10, 1, 4, generator=torch.Generator().manual_seed(3), dtype=F64)
    runs = []
    for engine in ("mujoco", "ode"):
        graph = make_graph(objects, engine, agent=looker(4), actuation_delay={"left": 0.02})
        runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 10, 1))
        state, _ = runtime.reset({}, torch.Generator())
        runs.append(runtime.rollout(state, actions)[1])
    for name in ("left_sensor", "right_sensor"):
        # One has the commands of each step of the physics, the other their mean over a tick of 10 ms.
        np.testing.assert_allclose(runs[0][name][..., :4], runs[1][name][..., :4], atol=2e-2)
    assert (runs[0]["left_sensor"] - runs[0]["right_sensor"]).abs().max() > 0.01


class Limiter(Node):
    """Keeps commands away from the end of the rail, by what the sensor measures."""

    inputs = ("agent", "sensor")

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1, dtype=F64)

    def step(self, parameters, state, inputs):
        command, position = inputs["agent"].data[:, -1], inputs["sensor"].data[:, -1, :1]
        return state, torch.where(position > 0.1, -1.0 * position, command)


class Halve(Node):
    inputs = ("agent",)

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1, dtype=F64)

    def step(self, parameters, state, inputs):
        return state, 0.5 * inputs["agent"].data[:, -1, :1]


def test_nodes_between_agent_and_actuator_change_the_commands():
    push = torch.full((60, 1, 1), 2.0, dtype=F64)
    free, limited, half, quarter = (
        run(make_graph(MjcfObject(PUSHER), "mujoco", agent=looker(1), action_nodes=nodes), scale * push)[
            "sensor"
        ]
        for nodes, scale in (
            ((), 1.0),
            ((Limiter("limiter", 100),), 1.0),
            ((Halve("first", 20), Halve("second", 20)), 1.0),
            ((), 0.25),
        )
    )
    assert free[-1, 0, 0] > 1.0
    assert limited[..., 0].max() < 0.5
    torch.testing.assert_close(half, quarter)
    two = two_objects(action_nodes={"hand": [Halve("half", 20)]})
    assert set(two.index) >= {"half"}
    with pytest.raises(EngineError, match="say of which object they are, by name: hand, box"):
        two_objects(action_nodes=[Halve("half", 20)])
    wrong = type("Wrong", (Halve,), {"inputs": ("camera",)})("wrong", 20)
    with pytest.raises(
        EngineError, match='action node "wrong" has an input "camera"; it can have agent, sensor'
    ):
        make_graph(MjcfObject(PUSHER), "mujoco", action_nodes=[wrong])


def test_an_environment_with_an_action_node_sends_what_the_node_makes_of_the_action():
    seen = []
    for nodes, action in (([Halve("half", 20)], 0.8), ([], 0.4)):
        env = EngineEnv("rod_pendulum", engine="ode", action_nodes=nodes)
        env.reset(seed=1, options={"initial_state": [1.0, 0.0]})
        seen.append([env.step(np.array([action]))[0] for _ in range(5)])
        env.close()
    np.testing.assert_allclose(*seen, atol=1e-6)


class Reach(Looker):
    inputs = ("sensor",)

    def observe(self, parameters, state, inputs, action):
        seen = inputs["sensor"].data[:, -1]
        return state, {"observation": seen, "reward": -(seen[:, 0] ** 2)}


def test_a_vector_of_environments_randomises_the_model():
    agent = Reach("agent", 20, initial_action=torch.zeros(2, dtype=F64))
    graph = make_graph(MjcfObject(ARM, ("q_shoulder", "dq_elbow")), "mujoco", agent=agent)
    spaces = gymnasium.spaces.Box(-1.0, 1.0, (2,)), gymnasium.spaces.Box(-np.inf, np.inf, (2,))
    envs = GraphVectorEnv(8, graph, *spaces, max_episode_steps=10, randomize={"world.mass(fore)": (0.2, 1.5)})
    envs.reset(seed=0)
    for _ in range(12):
        observation, reward, *_ = envs.step(np.zeros((8, 2)))
    assert observation.shape == (8, 2)
    assert np.isfinite(reward).all()
    assert len(np.unique(observation[:, 0])) == 8


def test_a_world_travels_and_goes_on():
    graph = make_graph(MjcfObject(ARM), "mujoco", agent=looker(2))
    actions = torch.randn(6, 1, 2, generator=torch.Generator().manual_seed(2), dtype=F64)
    first = run(graph, actions)["truth"]
    again = run(pickle.loads(pickle.dumps(graph)), actions)["truth"]
    assert (first == again).all()


@pytest.mark.study
def test_an_mjcf_world_is_fitted_to_a_recording_without_it():
    measured = ("q_shoulder", "q_elbow")
    graph = make_graph(MjcfObject(ARM, measured), "mujoco", agent=looker(2), actuation_delay=0.017)
    true = {"world": {"mass(fore)": torch.tensor(0.8, dtype=F64)}}
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 30, 1))
    drawn = torch.Generator().manual_seed(1)
    policy = lambda _: torch.randn(1, 2, generator=drawn, dtype=F64)  # noqa: E731
    episode = record_episodes(runtime, policy, true, torch.Generator())[0][0]
    added = make_graph(MjcfObject(ARM, measured), "mujoco", agent=looker(2))
    replay = replay_record(
        drop_nodes(graph, episode, ["world"]),
        add=[added.node("world"), added.node("sensor")],
        connect=[Connection("agent", "world", window=4, skip=True), Connection("world", "sensor")],
    )
    sought = {"world.mass(fore)": (0.3, 1.5), "agent->world": (0.0, 0.05)}
    start = {"world": {"mass(fore)": torch.tensor(0.5, dtype=F64)}}
    fit = fit_replay(replay, start, sought, {"sensor": 1e-3}, population=12, generations=25, executor="eager")
    assert fit.estimates["world.mass(fore)"].value == pytest.approx(0.8, rel=0.02)
    assert fit.estimates["agent->world"].value == pytest.approx(0.017, abs=1e-3)


REFUSED = [
    (lambda: make_graph("no_such.xml", "mujoco"), "no_such.xml: there is no such file"),
    (lambda: make_graph("<mujoco><worldbody><bdy/></worldbody></mujoco>", "mujoco"), "MuJoCo cannot read it"),
    (lambda: make_graph(MjcfObject(ARM, ("q_elbo",)), "mujoco"), 'no sensor "q_elbo"; did you mean q_elbow'),
    (lambda: Scene({"": MjcfObject(ARM, keyframe="bend")}), 'no keyframe "bend"; it has bent'),
    (lambda: make_graph({"a b": ARM}, "mujoco"), 'object "a b": give it a name of letters, digits and _'),
    (
        lambda: make_graph({"a": ARM}, "mujoco", actuation_delay={"b": 0.1}),
        'there is no object "b"; there are a',
    ),
    (
        lambda: make_graph({"a": ARM}, "mujoco", action_entries={"a": [0]}),
        'action_entries of "a": give 2 entries',
    ),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_what_an_mjcf_engine_cannot_do_is_told(make, message):
    with pytest.raises(EngineError, match=message):
        make()


@settings(max_examples=50, deadline=None)
@given(
    arrivals=st.lists(st.floats(-0.02, 0.01), min_size=1, max_size=4),
    parts=st.integers(1, 6),
    seed=st.integers(0, 100),
)
def test_commands_hold_from_their_arrival_to_the_next(arrivals, parts, seed):
    """Against sums over a fine grid of time."""
    received = torch.tensor([[-np.inf, *sorted(arrivals)]], dtype=F64)
    values = torch.randn(1, len(arrivals) + 1, 2, generator=torch.Generator().manual_seed(seed), dtype=F64)
    seen = Input(values, torch.zeros(received.shape), received, received, torch.tensor([0.01], dtype=F64))
    means = means_within_tick(values, seen, 0.01, parts)
    grid = (np.arange(6000 * parts) + 0.5) * 0.01 / (6000 * parts)
    newest = (received[0].numpy()[None] <= grid[:, None]).sum(1) - 1
    expected = values[0].numpy()[newest].reshape(parts, 6000, 2).mean(1)
    np.testing.assert_allclose(means[0], expected, atol=4e-3)
