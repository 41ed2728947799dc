"""Questions and answers between the nodes of a graph, in simulated and in wall-clock time."""

import os
import pty
import threading

import numpy as np
import pytest
import torch
from imitation_script import observe, steer

from baselines.imitation.asking import Always, AtRandom
from baselines.imitation.config import ImitationConfig
from baselines.imitation.graph import AskingStudent, imitation_graph
from baselines.imitation.learner import Learner
from baselines.imitation.nodes import Keys, Script
from baselines.imitation.policy import make_ensemble
from deepkoco.graph import Uniform, draw_timing, replay_episode
from deepkoco.graph.live import ConcurrentRuntime, SimulatedRuntime, WallClockRuntime
from deepkoco.systems import make_system

CONFIG = ImitationConfig(members=3, hidden=(16,), updates=100)


def student(rule=None, acts=False):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        learner = Learner(make_ensemble(3, np.array([-2.0]), np.array([2.0]), CONFIG), CONFIG)
    return AskingStudent(learner, rule or Always(), observe, acts), learner


def parameters(angle=0.4):
    values = make_system("rod_pendulum").default_parameters() | {"start": torch.tensor([[angle, 0.0]])}
    return {"world": values, "sensor": values}


def simulate(graph, asking, steps=40, seed=0):
    timing = draw_timing(graph, np.random.default_rng(seed), steps=steps, batch=1)
    with SimulatedRuntime(graph, timing) as runtime:
        runtime.reset(parameters(), torch.Generator().manual_seed(0))
        asking.start()
        runtime.run(asking, steps)
        return runtime.finish()


def generators():
    return torch.Generator().manual_seed(1), torch.Generator().manual_seed(2)


def right(learner):
    """Whether each answer is the teacher's to the observation that it is joined to."""
    labels = learner.labels
    return torch.allclose(2.0 * labels.targets, steer(labels.observations).float(), atol=1e-6)


@pytest.mark.parametrize("delay", [0.0, 0.12, Uniform(0.0, 0.3)])
def test_late_answers_are_joined_to_what_was_asked(delay):
    graph = imitation_graph("rod_pendulum", Script(steer), 3, 1, answer_delay=delay, sensing_delay=0.01)
    asking, learner = student()
    simulate(graph, asking)
    answered = asking.answered
    asking.learn(*generators())
    assert asking.asked == 40
    assert 40 - 8 <= answered == len(learner.labels) < 40  # the last ones are still under way
    assert right(learner)


def test_only_what_is_asked_is_answered():
    graph = imitation_graph("rod_pendulum", Script(steer), 3, 1)
    asking, learner = student(AtRandom(0.3, torch.Generator().manual_seed(0)))
    simulate(graph, asking, 60)
    asking.learn(*generators())
    assert 8 <= asking.asked <= 30
    assert asking.asked - 1 <= len(learner.labels) <= asking.asked
    assert right(learner)


def test_a_slow_teacher_answers_the_newest_question():
    graph = imitation_graph("rod_pendulum", Script(steer), 3, 1, teacher_rate=5.0)
    asking, learner = student()
    simulate(graph, asking, 40)
    asking.learn(*generators())
    assert 8 <= len(learner.labels) <= 10
    assert right(learner)


def test_the_teacher_acts_in_a_demonstration():
    graph = imitation_graph("rod_pendulum", Script(steer), 3, 1)
    asking, _ = student(acts=True)
    episode = simulate(graph, asking)
    commands = torch.as_tensor(episode.outputs["command"])[:, 0]
    answers = torch.as_tensor(episode.outputs["teacher"])[:, 1]
    # An answer acts in the step after its question.
    assert torch.allclose(commands[2:38], answers[1:37])


def test_every_runtime_gives_the_same_answers():
    graph = imitation_graph("rod_pendulum", Script(steer), 3, 1, answer_delay=0.1)
    asking, _ = student()
    episode = simulate(graph, asking)
    again, _ = replay_episode(graph, episode, parameters(), torch.Generator().manual_seed(0))
    other, _ = student()
    with ConcurrentRuntime(graph, draw_timing(graph, np.random.default_rng(0), steps=40, batch=1)) as runtime:
        runtime.reset(parameters(), torch.Generator().manual_seed(0))
        runtime.run(other, 40)
        concurrent = runtime.finish()
    for name in ("teacher", "world", "command"):
        assert torch.equal(torch.as_tensor(again.outputs[name]), torch.as_tensor(episode.outputs[name]))
        assert torch.equal(torch.as_tensor(concurrent.outputs[name]), torch.as_tensor(episode.outputs[name]))


def test_the_same_nodes_ask_and_answer_by_the_clock():
    graph = imitation_graph("rod_pendulum", Script(steer), 3, 1, answer_delay=0.01)
    asking, learner = student()
    with WallClockRuntime(graph) as runtime:
        runtime.reset(parameters(), torch.Generator().manual_seed(0))
        asking.start()
        runtime.run(asking, 30)
        episode = runtime.finish()
    asking.learn(*generators())
    assert asking.asked == 30
    assert len(learner.labels) >= 1  # a busy machine is late; what comes is right
    assert right(learner)
    again, _ = replay_episode(graph, episode, parameters(), torch.Generator().manual_seed(0))
    assert torch.equal(torch.as_tensor(again.outputs["teacher"]), torch.as_tensor(episode.outputs["teacher"]))


def test_a_person_answers_in_real_time():
    """The key is pressed all the time, as a terminal repeats it."""
    ours, theirs = pty.openpty()
    keys = Keys(np.array([-2.0]), np.array([2.0]), theirs)
    graph = imitation_graph("rod_pendulum", keys, 3, 1, reaction=0.15)
    asking, learner = student()
    over = threading.Event()

    def press():
        while not over.wait(0.03):
            os.write(ours, b"d")

    person = threading.Thread(target=press)
    person.start()
    try:
        with WallClockRuntime(graph, threads=("teacher",)) as runtime:
            runtime.reset(parameters(), torch.Generator().manual_seed(0))
            asking.start()
            runtime.run(asking, 40)
            episode = runtime.finish()
    finally:
        over.set()
        person.join()
        os.close(ours)
        os.close(theirs)
    asking.learn(*generators())
    assert len(learner.labels) >= 1
    assert (learner.labels.targets == 1.0).all()
    numbers = torch.as_tensor(episode.outputs["teacher"])[:, 0]
    given = numbers[numbers >= 0]
    assert (given.diff() > 0).all()
