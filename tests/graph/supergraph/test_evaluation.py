"""The graphs of the evaluation, against a slow generator written from the rules, and the command."""

import json

import numpy as np
import pytest

from experiments.benchmarks.supergraph_efficiency import main
from experiments.benchmarks.topologies import THETA, episode_seeds, generate, make_topology


def plain_episode(topology, sigma, seed, length):
    """Vertices and edges that the last supervisor step depends on, one draw and one message at a time."""
    generator = np.random.default_rng(seed)
    times = []
    for rate in topology.rates:
        x, t, ticks = np.float32(0), np.float32(0), [np.float32(0)]
        for i in range(int(np.ceil(length * rate))):
            if i:
                pull = THETA * (0.0 - float(x))
                x = np.float32(float(x) + pull + sigma * generator.normal())
            period = max(np.float32(1 + x) / np.float32(rate), np.float32(1 / rate))
            t = np.float32(t + period)
            ticks.append(t)
        times.append(ticks)
    end = min(ticks[-1] for ticks in times)
    times = [[float(t) for t in ticks if t < end] for ticks in times]
    edges = {((k, i), (k, i + 1)) for k, ticks in enumerate(times) for i in range(len(ticks) - 1)}
    for a, b in topology.edges:
        latest = {}
        for i, sent in enumerate(times[a]):
            there = sent + 1 / topology.rates[a]
            ready = [j for j, t in enumerate(times[b]) if (t >= there if a < b else t > there)]
            if ready:
                latest.setdefault(ready[0], []).append(i)
        for j, messages in latest.items():
            for i in messages if topology.every else messages[-1:]:
                edges.add(((a, i), (b, j)))
    needed, grown = set(), {(0, len(times[0]) - 1)}
    while grown:
        needed |= grown
        grown = {u for u, v in edges if v in grown} - needed
    return needed, {(u, v) for u, v in edges if v in needed}


@pytest.mark.parametrize("name", ["v2v", "uav", "unidirectional", "bidirectional", "unirandom"])
def test_generated_graphs_equal_those_of_a_slow_generator(name):
    topology, episodes = generate(name, 5, 0.2, 3, 2, 2.0)
    for episode, seed in zip(episodes, episode_seeds(3, 2), strict=True):
        vertices, edges = plain_episode(topology, 0.2, seed, 2.0)
        names = list(zip(episode.kind.tolist(), episode.seq.tolist(), strict=True))
        assert set(names) == vertices
        assert {(names[a], names[b]) for a, b in episode.edges.tolist()} == edges
        assert len(episode.edges) == len(edges)


def test_a_platoon_is_led_and_every_vehicle_talks_to_the_simulator():
    topology = make_topology("v2v", 4, np.random.default_rng(0))
    assert topology.rates == (20.0, 20.0, 20.0, 200.0)
    simulator = {(k, 3) for k in range(3)} | {(3, k) for k in range(3)}
    assert set(topology.edges) == simulator | {(0, 1), (0, 2), (1, 2)}
    swarm = make_topology("uav", 4, np.random.default_rng(0))
    assert set(swarm.edges) == simulator | {(0, 1), (0, 2), (1, 0), (2, 0)}


def test_unknown_topologies_and_single_nodes_are_refused():
    with pytest.raises(ValueError, match='"ring" is none of v2v'):
        make_topology("ring", 4, np.random.default_rng(0))
    with pytest.raises(ValueError, match="at least 2"):
        make_topology("v2v", 1, np.random.default_rng(0))


@pytest.mark.parametrize("method", ["ours", "mcs", "gen", "top", "seq"])
def test_the_command_prints_one_object(method, capsys):
    code = main(["--nodes", "3", "--episodes", "1", "--length", "3", "--method", method, "--json"])
    result = json.loads(capsys.readouterr().out)
    assert code == 0
    assert {"size", "efficiency", "cpu_s", "bound"} <= set(result)
    assert 0 < result["efficiency"] <= 1


def test_a_missing_peer_is_reported_with_the_command_that_installs_it(capsys):
    options = ["--nodes", "2", "--episodes", "1", "--length", "1", "--peer", "--peer-python", "/none/python"]
    assert main(options) == 2
    assert "scripts/peers.sh" in capsys.readouterr().err
