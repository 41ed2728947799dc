"""The linear Kalman filter: the textbook's matrices, and in a graph the state now from measurements of the past."""

import numpy as np
import pytest
import torch
from filterpy.common import van_loan_discretization
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, solve_discrete_are

from deepkoco.fit.state.kalman import Gaussian, LinearModel, LinearModelError, predict, update
from deepkoco.fit.state.kalman_node import AgedKalmanNode, KalmanNode
from deepkoco.graph import BatchedRuntime, Connection, Graph, Node, Supervisor, draw_timing
from deepkoco.graph.delay import Deterministic, Lossy

A = np.array([[0.0, 1.0, 0.0], [-0.5, -0.2, 1.0], [0.0, 0.0, -0.7]])
B = np.array([[0.0], [0.0], [0.7]])
C = np.array([[1.0, 0.0, 0.0], [0.3, 1.0, 0.0]])
W = np.array([0.0, 0.02, 0.01])
R = np.array([0.1, 0.3])


def model(longest: float = 1.0) -> LinearModel:
    return LinearModel(A, B, C, W, R, longest)


def tensor(values) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float64)


@settings(max_examples=30, deadline=None)
@given(step=st.floats(0.0, 1.0))
def test_a_step_is_the_matrix_exponential(step):
    """Oracles: scipy's expm of the augmented matrix, and Van Loan's integral of the noise."""
    found = model().transition(tensor([step]))
    whole = expm(np.block([[A, B], [np.zeros((1, 4))]]) * step)
    np.testing.assert_allclose(found.state[0], whole[:3, :3], atol=1e-13)
    np.testing.assert_allclose(found.command[0], whole[:3, 3:], atol=1e-13)
    if step > 0.0:
        _, noise = van_loan_discretization(A, np.sqrt(np.diag(W)), step)
        np.testing.assert_allclose(found.noise[0], noise, atol=1e-13)


def test_a_sequence_is_that_of_filterpy():
    steps, generator = tensor([0.1, 0.7, 0.0, 0.4, 1.0]), np.random.default_rng(0)
    peer = KalmanFilter(3, 2)
    peer.x, peer.P, peer.H, peer.R = np.zeros((3, 1)), np.eye(3), C, np.diag(R**2)
    belief = Gaussian(torch.zeros(1, 3, dtype=torch.float64), torch.eye(3, dtype=torch.float64)[None])
    for h in steps:
        seen, command = generator.normal(size=2), generator.normal(size=1)
        one = model().transition(h[None])
        peer.predict(
            u=command[:, None], B=one.command[0].numpy(), F=one.state[0].numpy(), Q=one.noise[0].numpy()
        )
        peer.update(seen[:, None])
        belief = update(predict(belief, tensor(command)[None], one), model(), tensor(seen)[None])
        np.testing.assert_allclose(belief.mean[0], peer.x[:, 0], atol=1e-12)
        np.testing.assert_allclose(belief.covariance[0], peer.P, atol=1e-12)


def test_it_settles_at_the_riccati_equations_solution():
    one = model().transition(tensor([0.5]))
    belief = Gaussian(torch.zeros(1, 3, dtype=torch.float64), torch.eye(3, dtype=torch.float64)[None])
    for _ in range(400):
        before = predict(belief, torch.zeros(1, 1, dtype=torch.float64), one)
        belief = update(before, model(), torch.zeros(1, 2, dtype=torch.float64))
    expected = solve_discrete_are(one.state[0].numpy().T, C.T, one.noise[0].numpy(), np.diag(R**2))
    np.testing.assert_allclose(before.covariance[0], expected, rtol=1e-8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"noise_sd": [0.1, 0.0]}, "above 0"),
        ({"sensor": np.eye(2)}, "sensor has shape"),
        ({"longest_step": 300.0}, "shorter steps"),
    ],
)
def test_what_is_no_model_is_refused(change, message):
    options = {
        "dynamics": A,
        "command": B,
        "sensor": C,
        "noise_density": W,
        "noise_sd": R,
        "longest_step": 1.0,
    }
    with pytest.raises(LinearModelError, match=message):
        LinearModel(**{**options, **change})


class Mass(Node):
    """x'' = u, exactly, and what it showed a while ago: two ticks earlier in the first half, five in the second."""

    inputs = ("agent",)
    outputs = {"position": ((1,), torch.float64), "age": ((1,), torch.float64), "now": ((2,), torch.float64)}  # noqa: RUF012

    def init(self, parameters, generator, batch):
        return {
            "past": torch.zeros(batch, 8, 2, dtype=torch.float64),
            "tick": torch.zeros(batch, dtype=torch.int64),
        }

    def initial_output(self, parameters, state, batch):
        zero = torch.zeros(batch, 1, dtype=torch.float64)
        return {"position": zero, "age": zero, "now": torch.zeros(batch, 2, dtype=torch.float64)}

    def step(self, parameters, state, inputs, *, dt):
        position, speed = state["past"][:, 0].unbind(-1)
        force = torch.where(state["tick"] > 0, inputs["agent"].data[:, -1, 0], 0.0)
        now = torch.stack([position + dt * speed + 0.5 * dt**2 * force, speed + dt * force], -1)
        past = torch.cat([now[:, None], state["past"][:, :-1]], 1)
        late = torch.where(state["tick"] < 30, 2, 5)
        shown = torch.where((state["tick"] < 30)[:, None], past[:, 2], past[:, 5])[:, :1]
        return {"past": past, "tick": state["tick"] + 1}, {
            "position": shown,
            "age": (dt * late.double())[:, None],
            "now": now,
        }


class Watch(Supervisor):
    inputs = ("kalman", "mass")

    def observe(self, parameters, state, inputs, action):
        return state, {
            "estimate": inputs["kalman"].data["state"][:, -1],
            "truth": inputs["mass"].data["now"][:, -1],
        }


def _position(shown):
    return shown["position"]


class Age(Node):
    inputs = ("mass",)

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1, dtype=torch.float64)

    def step(self, parameters, state, inputs):
        return state, inputs["mass"].data["age"][:, -1]


def loop(age: float | None) -> Graph:
    mass = LinearModel([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [0.0, 1e-9], [1e-3], 0.2)
    kind, told = (AgedKalmanNode, {}) if age is None else (KalmanNode, {"age": age})
    start = (0.0, 0.0), (0.1, 0.1)
    kalman = kind("kalman", 10.0, mass, *start, longest_age=0.5, step=0.1, measured=_position, **told)
    watch = Watch(rate=10.0, initial_action=torch.zeros(1, dtype=torch.float64))
    nodes = [Mass("mass", 10.0), Age("age", 10.0), kalman, watch]
    connections = [
        Connection("agent", "mass", skip=True),
        Connection("mass", "age"),
        Connection("mass", "kalman", name="sensor"),
        Connection("agent", "kalman", name="command", skip=True, window=kalman.commands_needed(10.0)),
        Connection("kalman", "agent"),
        Connection("mass", "agent"),
    ]
    if age is None:
        connections.append(Connection("age", "kalman"))
    else:
        nodes.remove(nodes[1])
        connections.remove(connections[1])
    return Graph(nodes, connections)


def errors(graph: Graph, executor: str, varying: float) -> np.ndarray:
    timing = draw_timing(graph, np.random.default_rng(0), 60, 1)
    runtime = BatchedRuntime(graph, timing, executor=executor)
    forces = 1.0 + varying * torch.randn(
        60, 1, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64
    )
    state, _ = runtime.reset({}, torch.Generator().manual_seed(0))
    _, taken = runtime.rollout(state, forces)
    return (taken["estimate"] - taken["truth"])[:, 0].abs().numpy()


@pytest.mark.parametrize("executor", ["eager", "fused"])
def test_with_the_age_of_each_message_the_estimate_is_the_state_now(executor):
    """Without noise in the world the filter that knows the ages is exact, also while they change."""
    assert errors(loop(None), executor, varying=0.0).max() < 1e-9
    # Over a step it takes the mean of the commands: of forces of 1 N, in steps of 0.1 s, a few mm.
    assert errors(loop(None), executor, varying=1.0).max() < 0.01


def test_a_constant_age_is_right_while_it_is_and_wrong_afterwards():
    off = errors(loop(0.2), "eager", varying=0.0)
    assert off[:28].max() < 1e-9
    assert off[35:].max() > 0.5  # 0.3 s at 3 m/s and more


def test_a_model_for_shorter_steps_is_refused():
    mass = LinearModel([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [0.0, 1e-9], [1e-3], 0.05)
    with pytest.raises(LinearModelError, match=r"made for 0\.05 s"):
        KalmanNode("kalman", 10.0, mass, (0.0, 0.0), (0.1, 0.1), age=0.2, longest_age=0.5, step=0.1)


class Plant(Node):
    """x(k + 1) = F x(k) + G u(k), as the model of the filter."""

    inputs = ("command",)

    def init(self, parameters, generator, batch):
        return {"x": torch.tensor([[1.0, 0.0]], dtype=torch.float64).expand(batch, 2).clone()}

    def initial_output(self, parameters, state, batch):
        return state["x"]

    def step(self, parameters, state, inputs):
        x = state["x"] @ FREE.T + inputs["command"].data[:, -1] @ DRIVEN.T
        return {"x": x}, x


class Seat(Supervisor):
    inputs = ("filter", "plant")

    def init(self, parameters, generator, batch):
        return {}

    def observe(self, parameters, state, inputs, action):
        shown = inputs["filter"].data
        parts = (shown["state"][:, -1], inputs["plant"].data[:, -1], shown["covariance"][:, -1].flatten(1))
        return state, {"observation": torch.cat(parts, 1), "reward": action[:, 0]}


SWING = np.array([[0.0, 1.0], [-4.0, -0.4]])
PUSH = np.array([[0.0], [4.0]])
FREE = torch.tensor(expm(0.1 * SWING))
DRIVEN = torch.tensor(np.linalg.solve(SWING, expm(0.1 * SWING) - np.eye(2)) @ PUSH)


def test_a_filter_without_messages_goes_on_with_the_commands_and_becomes_less_certain():
    """Nine of ten messages are lost, and the filter keeps the commands of the last 0.3 s only."""
    model = LinearModel(SWING, PUSH, [[1.0, 0.0]], [0.0, 1e-2], [0.01], longest_step=0.2)
    own = KalmanNode(
        "filter",
        10.0,
        model,
        (1.0, 0.0),
        (0.5, 0.5),
        longest_age=0.2,
        step=0.1,
        measured=lambda shown: shown[..., :1],
    )
    graph = Graph(
        [Plant("plant", 10.0), own, Seat("agent", 10.0, initial_action=torch.ones(1, dtype=torch.float64))],
        [
            Connection("plant", "filter", name="sensor", delay=Lossy(Deterministic(0.0), 0.9)),
            Connection("agent", "filter", name="command", skip=True, window=own.commands_needed(10.0)),
            Connection("agent", "plant", name="command", skip=True),
            Connection("filter", "agent"),
            Connection("plant", "agent"),
        ],
    )
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 200, 1), executor="eager")
    start, _ = runtime.reset({}, [torch.Generator().manual_seed(0)], {})
    actions = torch.sign(torch.sin(0.35 * torch.arange(200) + 0.1))[:, None, None].double()
    _, taken = runtime.rollout(start, actions, record=["observation"])
    seen = taken["observation"][:, 0]
    # Unbounded, the errors were 2.3 and more, of a motion of about 3.
    np.testing.assert_allclose(seen[:, :2], seen[:, 2:4], atol=0.02)
    assert float(seen[:, 4].max()) > 2.0 * float(seen[:, 4].median())


def test_an_age_beyond_the_longest_is_refused():
    model = LinearModel(SWING, PUSH, [[1.0, 0.0]], [0.0, 1e-2], [0.01], longest_step=0.2)
    with pytest.raises(LinearModelError, match=r"age = 0\.3 s; give 0 to the longest age, 0\.2 s"):
        KalmanNode("filter", 10.0, model, (0.0, 0.0), (1.0, 1.0), age=0.3, longest_age=0.2, step=0.1)
