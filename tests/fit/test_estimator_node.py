"""The estimator as a node: against an exact Kalman filter, and in each executor and runtime."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from deepkoco.envs.delay_env import DelayGraphVectorEnv
from deepkoco.fit.state.estimator_node import StateEstimator
from deepkoco.fit.state.unscented import FilterError
from deepkoco.graph import BatchedRuntime, Input, SimulatedRuntime, draw_timing, replay_episode
from deepkoco.graph.live import WallClockRuntime
from deepkoco.systems import Channel, Parameter, System, make_system

F64 = torch.float64
DAMPING, POSITION_SD, SPEED_NOISE = 0.5, 0.05, 0.2
SENSING, ACTUATION = 0.03, 0.02
A = np.array([[0.0, 1.0], [0.0, -DAMPING]])
DENSITY = np.diag([0.0, SPEED_NOISE**2])


class Sled(System):
    """x'' = u - d x' of 1 kg; only the position is measured."""

    name = "sled"
    joint_units = ("m",)
    parameters = (Parameter("damping", DAMPING, "N s/m", 0.0, 5.0, 0.1, "d"),)
    commands = (Channel("push", "N", "command", -5.0, 5.0),)
    measurements = (Channel("x", "m", "measurement", noise_sd=POSITION_SD),)

    def accelerations(self, parameters):
        return lambda motion: (motion.efforts[0] + motion.load(0) - parameters["damping"] * motion.speeds[0],)


def sled_estimator(ahead, step=0.0005, **changes):
    options = {
        "actuation_delay": ACTUATION, "sensing_delay": 0.0, "measurement_period": 0.02, "latest": 0.1,
        "start_sd": (1.0, 1.0), "longest_step": step,
    }  # fmt: skip
    return StateEstimator(
        Sled(), 10.0, (0.0, SPEED_NOISE**2), (POSITION_SD,), ahead=ahead, **{**options, **changes}
    )


def carried(mean, covariance, begin, end, commands):
    """Exact prediction of a Kalman filter: matrix exponentials between the times at which commands act."""
    for left, right in pairwise([begin, *(t for t, _ in commands if begin < t < end), end]):
        push, h = [u for t, u in commands if t <= left][-1], right - left
        # Van Loan: one exponential gives the transition and the integral of the noise.
        block = np.zeros((4, 4))
        block[:2, :2], block[:2, 2:], block[2:, 2:] = -A, DENSITY, A.T
        big = expm(block * h)
        phi, driven = big[2:, 2:].T, np.zeros((3, 3))
        driven[:2, :2], driven[1, 2] = A, 1.0
        mean = phi @ mean + expm(driven * h)[:2, 2] * push
        covariance = phi @ covariance @ phi.T + phi @ big[:2, 2:]
    return mean, covariance


def exact(measurements, commands, stop):
    """State and covariance at ``stop`` of a Kalman filter over measurements (time, value) in their order."""
    mean, covariance, at = np.zeros(2), np.eye(2), 0.0
    for taken, value in measurements:
        mean, covariance = carried(mean, covariance, at, taken, commands)
        gain = covariance[:, 0] / (covariance[0, 0] + POSITION_SD**2)
        mean = mean + gain * (value - mean[0])
        covariance, at = covariance - np.outer(gain, covariance[0]), taken
    return carried(mean, covariance, at, stop, commands)


def window(times, values, first, count, now):
    """The last ``count`` messages as an input, the number ``first`` being the oldest."""
    seq = np.arange(first, first + count)
    sent = [times[k] if k >= 0 else -math.inf for k in seq]
    data = [values[k] if k >= 0 else values[0] for k in seq]
    received = torch.tensor([sent], dtype=F64)
    return Input(
        torch.tensor(data, dtype=F64)[None, :, None], torch.tensor(seq)[None], received, received,
        torch.tensor([now], dtype=F64),
    )  # fmt: skip


def played(estimator, late=0.0):
    """The outputs of three ticks, with irregular measurements of which two or three are new at each."""
    rng = np.random.default_rng(3)
    taken = np.cumsum(rng.uniform(0.01, 0.06, 9))
    seen, pushes, sent = rng.standard_normal(9), (0.0, 1.0, -2.0, 0.5), (-math.inf, 0.0, 0.1, 0.2)
    state, found = estimator.init({}, torch.Generator(), 1), []
    for tick, (newest, now) in enumerate(((2, 0.1), (4, 0.2), (7, 0.3))):
        first = newest - 3
        sensor = window(list(taken + late), list(seen), first, 4, now)
        agent = window(list(sent[1:]), list(pushes[1:]), tick - 3, 4, now)
        agent = agent._replace(data=torch.where(agent.seq < 0, 0.0, agent.data[..., 0])[..., None])
        state, output = estimator.step({}, state, {"sensor": sensor, "agent": agent})
        found.append(output)
    measured = [(float(taken[0]), float(seen[0])), *zip(taken[1:8].tolist(), seen[1:8].tolist(), strict=True)]
    acting = [(-math.inf, 0.0), *((t + ACTUATION, u) for t, u in zip(sent[1:], pushes[1:], strict=True))]
    return found, measured, acting


@pytest.mark.parametrize("ahead", [ACTUATION, 0.08])
def test_the_node_matches_an_exact_kalman_filter_that_predicts_with_the_commands(ahead):
    found, measured, acting = played(sled_estimator(ahead))
    # What the sensor showed before its first message is a measurement of the start.
    known = [(0.0, measured[0][1]), *measured]
    for output, newest, now in zip(found, (2, 4, 7), (0.1, 0.2, 0.3), strict=True):
        mean, covariance = exact(
            known[: newest + 2], [(t, u) for t, u in acting if t < now + ACTUATION], now + ahead
        )
        assert output["state"][0].numpy() == pytest.approx(mean, rel=5e-4)
        own = output["root"][0] @ output["root"][0].mT
        assert own.numpy() == pytest.approx(covariance, rel=0.03, abs=2e-4)
        assert float(output["measurement"]) == float(output["state"][0, 0])


def test_without_a_prediction_the_estimate_is_that_of_the_newest_measurement():
    found, measured, acting = played(sled_estimator(None))
    mean, _ = exact([(0.0, measured[0][1]), *measured], acting, measured[-1][0])
    assert found[-1]["state"][0].numpy() == pytest.approx(mean, rel=5e-4)


def test_a_delay_before_the_stamp_is_taken_off():
    punctual, _, _ = played(sled_estimator(0.05))
    late, _, _ = played(sled_estimator(0.05, sensing_delay=SENSING), late=SENSING)
    assert torch.allclose(punctual[-1]["state"], late[-1]["state"], atol=1e-12)


def test_a_missing_measurement_leaves_the_prediction():
    estimator = sled_estimator(None)
    state = estimator.init({}, torch.Generator(), 1)
    agent = window([0.0], [0.0], 0, 1, 0.1)
    sensor = window([0.05], [math.nan], 0, 1, 0.1)
    after, output = estimator.step({}, state, {"sensor": sensor, "agent": agent})
    assert output["state"].tolist() == [[0.0, 0.0]]
    assert float(after["since"]) == 0.05


def test_an_angle_is_followed_through_its_wrap():
    pendulum = make_system("rod_pendulum")
    estimator = StateEstimator(
        pendulum, 10.0, (0.0, 1.0), (0.01, 0.05), ahead=None, measurement_period=0.1, latest=0.1,
        start_sd=(3.0, 10.0),
    )  # fmt: skip
    state = estimator.init({}, torch.Generator(), 1)
    agent = Input(
        *(torch.zeros(1, 1, 1, dtype=F64), *torch.zeros(3, 1, 1, dtype=F64).unbind(0), torch.zeros(1))
    )
    for k, angle in enumerate((3.1, -3.13, -3.08)):  # 3.1 rad, then 3.153 rad and 3.203 rad
        sensor = Input(
            torch.tensor([[[angle, 0.55]]], dtype=F64), torch.tensor([[k]]),
            *(torch.tensor([[0.1 * k]], dtype=F64),) * 2, torch.tensor([0.1 * k], dtype=F64),
        )  # fmt: skip
        state, output = estimator.step({}, state, {"sensor": sensor, "agent": agent})
    assert math.remainder(float(output["state"][0, 0]) - 3.203, 2 * math.pi) == pytest.approx(0.0, abs=0.03)


LATE = {"law": "gaussian", "loc": 0.05, "scale": 0.01}


def delayed_env(count=2, executor="eager", **settings):
    return DelayGraphVectorEnv(
        count, 40, system="pendulum", noise=True, sensing_delay=LATE, actuation_delay=0.02,
        action_units="physical", executor=executor, **settings,
    )  # fmt: skip


def along(envs, steps=40):
    """Observations of some steps, and the true angles from upright then."""
    rng, rows = np.random.default_rng(1), []
    observation, info = envs.reset(seed=5)
    for _ in range(steps):
        rows.append((observation, info["angle_from_upright"]))
        action = rng.uniform(-2.0, 2.0, (envs.num_envs, 1)).astype(np.float32)
        observation, *_, info = envs.step(action)
    observations, angles = zip(*rows, strict=True)
    return np.array(observations), np.array(angles)


def test_the_compiled_node_does_what_the_eager_one_does():
    observations = {}
    for executor in ("eager", "fused"):
        envs = delayed_env(executor=executor, estimator="predicted")
        observations[executor], _ = along(envs)
        assert envs.executor == executor
    np.testing.assert_allclose(observations["fused"], observations["eager"], atol=1e-6)


def test_a_prediction_shows_the_state_that_the_command_of_the_tick_meets():
    """20 ms, the delay of the commands, are one step: the next true angle."""
    seen, truth = along(delayed_env(16, estimator="predicted", world_rate=100.0))
    predicted = np.arctan2(seen[..., 1], seen[..., 0])
    away = np.remainder(predicted[5:-1] - truth[6:] + np.pi, 2 * np.pi) - np.pi
    late, truth = along(delayed_env(16, estimator="none", world_rate=100.0))
    newest = np.arctan2(late[..., 1], late[..., 0])
    behind = np.remainder(newest[5:-1] - truth[6:] + np.pi, 2 * np.pi) - np.pi
    assert np.sqrt((away**2).mean()) < 0.05 * np.sqrt((behind**2).mean())


def test_the_simulated_runtime_gives_the_same_bits():
    graph = delayed_env(1, estimator="predicted").graph
    parameters = {node.name: make_system("pendulum").default_parameters() for node in graph.nodes}
    timing = draw_timing(graph, np.random.default_rng(2), 12, 1)
    actions = torch.tensor(np.random.default_rng(3).uniform(-2.0, 2.0, (10, 1, 1)))
    batched = BatchedRuntime(graph, timing)
    state, _ = batched.reset(parameters, torch.Generator().manual_seed(0))
    with SimulatedRuntime(graph, timing) as runtime:
        running, _ = runtime.reset(parameters, torch.Generator().manual_seed(0))
        for action in actions:
            state, _ = batched.step(state, action)
            running, _ = runtime.step(running, action)
        assert torch.equal(running.readings["observation"], state.readings["observation"])


def test_a_run_in_real_time_replays_with_the_same_estimates():
    """The filter goes by the stamps, so what it makes of real ones follows from the record."""
    graph = delayed_env(1, estimator="predicted").graph
    parameters = {node.name: make_system("pendulum").default_parameters() for node in graph.nodes}
    with WallClockRuntime(
        graph, threads=("world", "sensor", "estimator"), time_limit=20.0, beat_limit=20.0
    ) as runtime:
        runtime.reset(parameters, torch.Generator().manual_seed(0))
        runtime.run(lambda seen: torch.tensor([[1.0]], dtype=F64), 40)
        episode = runtime.finish()
    again, _ = replay_episode(graph, episode, parameters, torch.Generator().manual_seed(0))
    assert len(episode.outputs["estimator"])  # few on a busy machine
    np.testing.assert_array_equal(again.outputs["estimator"], episode.outputs["estimator"])
    state = graph.parts["estimator"].split_array(episode.outputs["estimator"])["state"]
    assert np.isfinite(state).all()


def test_what_an_environment_draws_stays_hidden_from_the_estimator():
    """The same start and commands: the observation of the first tick is that of the nominal model's prediction."""
    envs = delayed_env(3, estimator="predicted", randomize={"mass": (0.03, 0.08)})
    envs.reset(seed=0)
    known = envs.state.parameters
    assert known["world"]["mass"].shape == (3,)
    assert known["estimator"]["mass"].ndim == 0


def test_random_ranges_of_the_sensing_delay_reach_the_estimator():
    envs = DelayGraphVectorEnv(
        2,
        10,
        system="pendulum",
        estimator="filtered",
        randomize={"sensing_delay": (0.02, 0.06)},
        executor="eager",
    )
    envs.reset(seed=0)
    assert ((envs.drawn["sensing_delay"] >= 0.02) & (envs.drawn["sensing_delay"] <= 0.06)).all()


def test_the_filter_expects_the_middle_of_a_delay_that_is_drawn():
    envs = DelayGraphVectorEnv(
        1,
        10,
        system="pendulum",
        estimator="predicted",
        randomize={"actuation_delay": (0.01, 0.05)},
        executor="eager",
    )
    node = envs.graph.node("estimator")
    assert isinstance(node, StateEstimator)
    assert (node.actuation_delay, node.ahead) == pytest.approx((0.03, 0.03))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start_sd": (1.0,)}, "start_sd has 1 values; sled has 2"),
        ({"start_sd": (1.0, 0.0)}, "give values above 0"),
    ],
)
def test_sizes_and_deviations_are_checked(changes, message):
    with pytest.raises(FilterError, match=message):
        sled_estimator(None, **changes)
