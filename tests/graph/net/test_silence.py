"""Inputs that must not stop: what counts is when the newest message was sent, and no stamp puts the limit off."""

import time
from dataclasses import replace

import pytest
import torch
from two_ends import AMPLE, motor_graph

from deepkoco.graph.live.clocked import ClockedDriver, SilentInputError, clocked_schedule
from deepkoco.graph.live.crew_plan import input_places
from deepkoco.graph.live.inbox import Inbox
from deepkoco.graph.live.message import Message
from deepkoco.graph.live.runner import Runner

NANO = 10**9
HOUR = 3600 * NANO


class Driven:
    """A motor whose episode began an hour ago, by its driver, with a limit to the silence [s]."""

    def __init__(self, folder, limit):
        graph = motor_graph(folder)
        schedule = clocked_schedule(graph, "motor", False, 0)
        inputs = tuple(replace(rule, silence=round(limit * NANO)) for rule in schedule.inputs)
        runner, places = Runner(graph.node("motor"), graph.inputs_of("motor")), input_places(graph, "motor")
        runner.reset({}, torch.Generator(), {})
        runner.begin([torch.zeros(1, 1, dtype=torch.float64)])
        (self.edge,), self.inbox, self.origin = places, Inbox(), time.monotonic_ns() - HOUR
        self.inbox.begin(0)
        self.driver = ClockedDriver(
            runner, self.inbox, places, [], self.origin, 1.0, True, schedule=replace(schedule, inputs=inputs)
        )

    def send(self, seq, age, due=0):
        sent = time.monotonic_ns() - self.origin - age
        self.inbox.deliver(Message(0, self.edge, seq, sent, due, torch.ones(1, 1, dtype=torch.float64)))


def test_a_command_that_has_just_come_but_is_old_is_not_obeyed(tmp_path):
    motor = Driven(tmp_path, AMPLE)
    motor.send(0, age=HOUR // 2)
    with pytest.raises(
        SilentInputError, match=r"(no message for|newest message is) 1800\d+ ms.* 60000 ms is the limit"
    ):
        motor.driver.begin()


def test_an_old_message_after_a_new_one_does_no_harm(tmp_path):
    motor = Driven(tmp_path, AMPLE)
    motor.send(1, age=0)
    motor.send(0, age=HOUR // 2)
    assert motor.driver.begin() is not None


@pytest.mark.parametrize("stamps", [{"age": -HOUR}, {"age": 0, "due": 2 * HOUR}])
def test_a_stamp_in_the_future_does_not_put_the_limit_off(tmp_path, stamps):
    motor = Driven(tmp_path, 0.07)
    motor.send(0, **stamps)

    def run_on():
        for _ in range(3):
            motor.driver.begin()
            time.sleep(0.08)

    with pytest.raises(SilentInputError, match="70 ms is the limit"):
        run_on()
