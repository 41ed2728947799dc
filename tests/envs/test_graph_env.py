"""Environments from any graph: resets of their own, Gymnasium's three ways of starting anew."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from counting import ACTIONS, OBSERVATIONS, Counter, CountingAgent, counting_graph
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from deepkoco.envs.delay_wrapper import DelayWrapper
from deepkoco.envs.graph_env import FIRST_STEPS, GraphEnv
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.vector_delay_wrapper import VectorDelayWrapper
from deepkoco.graph import Connection, Graph, GraphError, HorizonError, Supervisor
from deepkoco.graph.delay import RecordedDelays

STRIDES = (1.0, 2.0, 0.25, 5.0)
LIMIT = 7


def together(mode: AutoresetMode = AutoresetMode.NEXT_STEP, **options) -> GraphVectorEnv:
    parameters = {"counter": {"stride": torch.tensor(STRIDES, dtype=torch.float64)}}
    return GraphVectorEnv(
        4, counting_graph(), ACTIONS, OBSERVATIONS, LIMIT, parameters, autoreset_mode=mode, **options
    )


def alone(stride: float = 1.0, **options) -> GraphEnv:
    return GraphEnv(
        counting_graph(), ACTIONS, OBSERVATIONS, parameters={"counter": {"stride": stride}}, **options
    )


def one_by_one(mode: AutoresetMode) -> SyncVectorEnv:
    return SyncVectorEnv([lambda s=s: TimeLimit(alone(s), LIMIT) for s in STRIDES], autoreset_mode=mode)


def test_one_episode_by_hand():
    """Stride 2: counts 0, 2, 4, 6; the reward is the count at which the action was chosen times it."""
    env = alone(2.0)
    observation, info = env.reset(seed=0)
    np.testing.assert_array_equal(observation, [0, 0])
    assert info == {"count": 0.0}
    steps = [env.step(np.array([1.0], np.float32)) for _ in range(3)]
    np.testing.assert_array_equal([step[0] for step in steps], [[2, 0], [4, 2], [6, 4]])
    assert [step[1] for step in steps] == [0.0, 2.0, 4.0]
    assert [step[2] for step in steps] == [False, False, True]
    assert steps[-1][4] == {"count": 6.0}


@pytest.mark.parametrize("mode", list(AutoresetMode)[:2], ids=lambda mode: mode.name)
def test_environments_end_and_start_anew_as_gymnasiums_own_vector_form_has_it(mode: AutoresetMode):
    ours, reference = together(mode), one_by_one(mode)
    np.testing.assert_array_equal(ours.reset(seed=0)[0], reference.reset(seed=0)[0])
    generator = np.random.default_rng(0)
    ends = np.zeros(4, int)
    for _ in range(40):
        actions = generator.uniform(0.0, 2.0, (4, 1)).astype(np.float32)
        mine, theirs = ours.step(actions), reference.step(actions)
        for value, expected in zip(mine[:4], theirs[:4], strict=True):
            np.testing.assert_allclose(value, expected, rtol=1e-6)
        np.testing.assert_allclose(mine[4]["count"], theirs[4]["count"])
        if mode == AutoresetMode.SAME_STEP:
            assert ("final_obs" in mine[4]) == ("final_obs" in theirs[4])
            for place in np.flatnonzero(theirs[4].get("_final_obs", np.zeros(4))):
                np.testing.assert_allclose(mine[4]["final_obs"][place], theirs[4]["final_obs"][place])
                count = theirs[4]["final_info"]["count"][place]
                assert mine[4]["final_info"]["count"][place] == pytest.approx(count)
        ends += mine[2] | mine[3]
    assert ends.min() >= 4
    assert len(set(ends.tolist())) > 1


def test_without_autoreset_a_mask_says_who_starts_anew():
    ours, reference = together(AutoresetMode.DISABLED), one_by_one(AutoresetMode.DISABLED)
    ours.reset(seed=0)
    reference.reset(seed=0)
    for _ in range(30):
        mine, theirs = ours.step(np.ones((4, 1))), reference.step(np.ones((4, 1), np.float32))
        for value, expected in zip(mine[:4], theirs[:4], strict=True):
            np.testing.assert_allclose(value, expected, rtol=1e-6)
        ended = mine[2] | mine[3]
        if ended.any():
            options = {"reset_mask": ended}
            observation, _ = ours.reset(options=dict(options))
            np.testing.assert_allclose(observation, reference.reset(options=dict(options))[0])


def test_without_autoreset_a_step_after_the_end_is_refused():
    env = together(AutoresetMode.DISABLED)
    env.reset(seed=0)
    env.step(np.ones((4, 1)))  # a stride of 5 is there at once
    with pytest.raises(gymnasium.error.ResetNeeded, match="environment 3 has ended"):
        env.step(np.ones((4, 1)))


def test_an_episode_that_is_cut_where_it_ends_is_both():
    """Stride 5/7 reaches 5 at step 7, the limit."""
    env = GraphVectorEnv(
        1, counting_graph(), ACTIONS, OBSERVATIONS, LIMIT, {"counter": {"stride": 5.0 / 7.0 + 1e-12}}
    )
    env.reset(seed=0)
    ends = [env.step(np.ones((1, 1)))[2:4] for _ in range(7)]
    assert ends[-1] == (np.array([True]), np.array([True]))
    assert not np.any(ends[:-1])


def test_a_delay_of_one_step_counts_one_step_later():
    env = GraphEnv(counting_graph(delay=0.1), ACTIONS, OBSERVATIONS, parameters={"counter": {"stride": 1.0}})
    env.reset(seed=0)
    counts = [env.step(np.array([action]))[4]["count"] for action in (3.0, 1.0, 0.0)]
    assert counts == [0.0, 3.0, 4.0]


def test_the_checker_finds_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*spec.*")  # it has no id to be made from
        check_env(alone(), skip_render_check=True)


def test_delays_and_parameters_are_drawn_anew_for_those_that_start_anew():
    env = GraphVectorEnv(
        6,
        counting_graph(),
        ACTIONS,
        OBSERVATIONS,
        LIMIT,
        randomize={"counter.stride": (1.0, 2.0), "agent->counter": (0.0, 0.3)},
        autoreset_mode=AutoresetMode.DISABLED,
    )
    env.reset(seed=0)
    before = env.drawn
    mask = np.array([True, False, True, False, False, False])
    env.reset(options={"reset_mask": mask})
    for name in ("counter.stride", "agent->counter"):
        np.testing.assert_array_equal(env.drawn[name][~mask], before[name][~mask])
        assert (env.drawn[name][mask] != before[name][mask]).all()
    timing, row = env.state.schedule.timing, env.state.row
    edge = timing.layout.connections.index("agent->counter")
    for b in range(6):
        sent, received = timing.messages_of(edge, int(row[b]))
        delay = (received - sent) / timing.resolution
        np.testing.assert_allclose(delay, env.drawn["agent->counter"][b], atol=1e-9)


def test_the_numbers_of_a_delay_law_may_be_drawn_too():
    law = {"law": "uniform", "low": (0.0, 0.1), "high": 0.3}
    env = GraphVectorEnv(
        40,
        counting_graph(),
        ACTIONS,
        OBSERVATIONS,
        30,
        {"counter": {"stride": 0.01}},
        {"agent->counter": law},
    )
    env.reset(seed=0)
    lows = env.drawn["agent->counter.low"]
    assert lows.min() >= 0.0
    assert np.ptp(lows) > 0.05
    timing, edge = env.state.schedule.timing, 0
    assert timing.layout.connections[edge] == "agent->counter"
    for b in range(40):
        sent, received = timing.messages_of(edge, int(env.state.row[b]))
        first = (received - sent)[0] / timing.resolution  # later ones may have waited for those before
        assert lows[b] - 1e-9 <= first <= 0.3 + 1e-9


def test_more_environments_than_traces_share_them():
    env = GraphVectorEnv(
        50, counting_graph(), ACTIONS, OBSERVATIONS, LIMIT, {"counter": {"stride": 1.0}},
        {"agent->counter": (0.0, 0.3)}, delay_traces=8,
    )  # fmt: skip
    env.reset(seed=0)
    assert len(env.state.schedule.timing.t_start) == 8
    assert len(np.unique(env.drawn["agent->counter"])) == 8


def test_every_episode_of_a_small_batch_has_delays_of_its_own():
    env = GraphVectorEnv(
        5, counting_graph(), ACTIONS, OBSERVATIONS, LIMIT, {"counter": {"stride": 1.0}},
        {"agent->counter": (0.0, 0.3)},
    )  # fmt: skip
    drawn = [env.reset(seed=1 if k == 0 else None) and env.drawn["agent->counter"] for k in range(20)]
    assert len(np.unique(drawn)) == 100


def test_a_seed_repeats_everything_and_other_resets_go_on():
    env = GraphVectorEnv(
        3, counting_graph(), ACTIONS, OBSERVATIONS, LIMIT,
        randomize={"counter.stride": (0.5, 3.0), "agent->counter": (0.0, 0.3)},
    )  # fmt: skip

    def episodes() -> bytes:
        env.reset(seed=5)
        seen = [env.step(np.ones((3, 1)))[0] for _ in range(30)]
        seen += [env.reset()[0]] + [env.step(np.ones((3, 1)))[0] for _ in range(5)]
        return np.array(seen).tobytes()

    assert episodes() == episodes()
    first, second = env.drawn["counter.stride"], (env.reset(), env.drawn["counter.stride"])[1]
    assert (first != second).all()


def test_an_action_in_vain_does_not_use_up_the_episode():
    """With next-step autoreset an environment that ends at the limit takes one more step that counts for nothing."""
    env = together()
    env.reset(seed=0)
    ends = np.zeros(4, int)
    for _ in range(4 * (LIMIT + 1)):
        _, _, terminated, truncated, _ = env.step(np.full((4, 1), 0.01))
        ends += terminated | truncated
    assert (ends == 4).all()


class Branching(Counter):
    """Decides on a number, which no compiled kernel can."""

    def step(self, parameters, state, inputs):
        if float(inputs["agent"].data.sum()) > 1e6:
            raise ArithmeticError
        return super().step(parameters, state, inputs)


def test_what_cannot_be_compiled_runs_all_the_same():
    graph = counting_graph()
    branching = Graph([Branching("counter", 10), CountingAgent()], graph.connections)
    options = {"parameters": {"counter": {"stride": 2.0}}}
    both = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for own in (graph, branching):
            env = GraphEnv(own, ACTIONS, OBSERVATIONS, **options)
            env.reset(seed=0)
            both.append([env.step(np.array([0.5]))[:3] for _ in range(4)])
            names = env.batch.executor
    assert names == "eager"
    np.testing.assert_array_equal([s[0] for s in both[0]], [s[0] for s in both[1]])
    with pytest.warns(RuntimeWarning, match="eager"):
        GraphEnv(branching, ACTIONS, OBSERVATIONS, executor="fused", **options).reset(seed=0)


def test_gymnasiums_wrappers_count_the_episodes():
    env = RecordEpisodeStatistics(together())
    env.reset(seed=0)
    lengths = []
    for _ in range(30):
        *_, info = env.step(np.ones((4, 1)))
        lengths += info["episode"]["l"][info["_episode"]].tolist() if "episode" in info else []
    assert {int(length) for length in lengths} == {5, 3, LIMIT, 1}  # 5 / stride, rounded up


def test_an_episode_longer_than_its_traces_is_told():
    env = alone(0.0, longest_episode=2)
    env.reset(seed=0)
    for _ in range(2):
        assert not env.step(np.ones(1))[3]
    with pytest.raises(HorizonError, match="longest_episode = 2"):
        env.step(np.ones(1))


@pytest.mark.parametrize("mode", ["random delays", "no delays"])
def test_delays_are_drawn_as_episodes_go_on(mode: str):
    """What is drawn later is what would have been drawn at once; so are the episodes after a long one."""
    options = {"parameters": {"counter": {"stride": 0.0}}}
    if mode == "random delays":
        options["randomize"] = {"agent->counter": (0.0, 0.3), "counter.stride": (0.0, 1e-3)}
    short, long = (
        GraphEnv(counting_graph(), ACTIONS, OBSERVATIONS, steps, **options)
        for steps in (None, 4 * FIRST_STEPS)
    )
    actions = np.random.default_rng(0).uniform(-1, 1, (3 * FIRST_STEPS, 1)).astype(np.float32)
    for seed, steps in ((2, 3 * FIRST_STEPS), (None, 5), (7, 5)):
        np.testing.assert_array_equal(short.reset(seed=seed)[0], long.reset(seed=seed)[0])
        for action in actions[:steps]:
            mine, other = short.step(action), long.step(action)
            assert mine[0].tobytes() == other[0].tobytes()
            assert mine[1:] == other[1:]


def test_delay_wrappers_take_the_rate_of_the_agent():
    """10 Hz: what is 0.2 s old was seen two steps before; the count grows by one a step."""
    single = DelayWrapper(alone(), sensing_delay=0.2)
    counts = [single.reset(seed=0)[0][0], *(single.step(np.ones(1, np.float32))[0][0] for _ in range(4))]
    assert counts == [0.0, 0.0, 0.0, 1.0, 2.0]
    batch = VectorDelayWrapper(together(), sensing_delay=0.2)
    batch.reset(seed=0)
    seen = [batch.step(np.ones((4, 1), np.float32))[0][0, 0] for _ in range(4)]
    assert seen == counts[1:]


def test_what_has_been_drawn_is_not_to_be_changed_from_outside():
    env = together(randomize={"counter.stride": (1.0, 2.0)})
    env.reset(seed=0)
    env.drawn["counter.stride"][:] = 100.0
    assert env.drawn["counter.stride"].max() <= 2.0


def test_a_step_before_the_reset_is_refused():
    with pytest.raises(gymnasium.error.ResetNeeded):
        alone().step(np.ones(1))


def test_what_holds_up_the_whole_graph_reaches_every_environment():
    """A stall of 0.5 s about every second: some commands are late, others in every environment."""
    graph = counting_graph()
    stalls = {"rate": 0.7, "duration": 0.5, "channels": ["agent->counter"]}
    stalled = Graph(graph.nodes, graph.connections, stalls=[stalls])
    env = GraphVectorEnv(6, stalled, ACTIONS, OBSERVATIONS, 40, {"counter": {"stride": 0.01}})
    env.reset(seed=0)
    assert len({late_commands(env, b) for b in range(6)}) > 3


def late_commands(env: GraphVectorEnv, environment: int) -> tuple[int, ...]:
    timing = env.state.schedule.timing
    edge = timing.layout.connections.index("agent->counter")
    sent, received = timing.messages_of(edge, int(env.state.row[environment]))
    return tuple(np.flatnonzero(received - sent > 0).tolist())


def test_recorded_delays_are_played():
    delays = np.array([0.0, 0.05, 0.1, 0.02, 0.07])
    recorded = RecordedDelays([{"agent->counter": delays}])
    options = {"parameters": {"counter": {"stride": 0.01}}, "recorded_delays": recorded}
    env = GraphVectorEnv(4, counting_graph(), ACTIONS, OBSERVATIONS, 30, **options)
    env.reset(seed=0)
    timing = env.state.schedule.timing
    edge = timing.layout.connections.index("agent->counter")
    for b in range(4):
        sent, received = timing.messages_of(edge, int(env.state.row[b]))
        seen = (received - sent)[:30] / timing.resolution
        places = [np.roll(np.tile(delays, 6), -shift) for shift in range(5)]
        assert any(np.allclose(seen[:5], place[:5], atol=1e-8) for place in places)


class Silent(Supervisor):
    def observe(self, parameters, state, inputs, action):
        return state, {"observation": inputs["counter"].data[:, -1]}


@pytest.mark.parametrize(
    ("supervisor", "message"),
    [
        (Supervisor(rate=10, initial_action=torch.zeros(1)), "override `observe`"),
        (Silent(rate=10, initial_action=torch.zeros(1)), r'"observation" has shape \(1, 1\), not \(1, 2\)'),
    ],
)
def test_a_supervisor_that_reads_too_little_is_refused(supervisor, message):
    counter = counting_graph().node("counter")
    graph = Graph(
        [counter, supervisor], [Connection("agent", "counter", skip=True), Connection("counter", "agent")]
    )
    with pytest.raises(GraphError, match=message):
        GraphEnv(graph, ACTIONS, OBSERVATIONS, parameters={"counter": {"stride": 1.0}}).reset(seed=0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"randomize": {"stride": (0, 1)}}, '"stride" is none of agent, agent->counter'),
        ({"randomize": {"agent->counter": (-0.1, 1)}}, "give .low, high. inside .0.0, inf"),
        ({"randomize": {"counter.stride": (2, 1)}}, "low, high"),
        ({"randomize": {"counter": {"law": "uniform", "low": (0.1, 0.0), "high": 1.0}}}, "counter.low"),
        ({"randomize": {"counter": {"law": "uniform", "low": (0.1, 2.0), "high": 1.0}}}, "uniform"),
        ({"randomize": {"stride": {"law": "uniform", "low": 0.0, "high": 1.0}}}, '"stride" is none of'),
        ({"delay_traces": 0}, "delay_traces = 0"),
        ({"autoreset_mode": "sometimes"}, "sometimes"),
    ],
)
def test_wrong_settings_are_told(options, message):
    with pytest.raises(ValueError, match=message):
        GraphVectorEnv(1, counting_graph(), ACTIONS, OBSERVATIONS, LIMIT, **options)


def test_a_wrong_mask_is_told():
    env = together()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.reset(seed=0, options={"reset_mask": np.array([True, False, False, False])})
    env.reset(seed=0)
    for mask in (np.zeros(4, bool), np.ones(3, bool), [True] * 4):
        with pytest.raises(ValueError, match="reset_mask"):
            env.reset(options={"reset_mask": mask})
