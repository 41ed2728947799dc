"""Nodes that live in processes of their own, and what runs them."""

import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import torch

from deepkoco.graph import Connection, Episode, Graph, Node, Supervisor
from tests.graph.timing_reference import Accumulate, policy

AMPLE = 60.0  # limit [s] that no healthy node and no process exceeds, however busy the machine is
PARTS = ("t_start", "t_end", "outputs", "t_sent", "t_received", "windows")


class Timed(Accumulate):
    """Adds up what it sees and how old it is."""

    def step(self, parameters, state, inputs):
        state, output = super().step(parameters, state, inputs)
        for seen in inputs.values():
            age = seen.t_start - seen.t_received[:, -1].clamp(min=-1.0)
            output = output + age[:, None]
        return state, output


class Device(Node):
    """Stands for hardware: leaves marks in a folder when it opens and closes, and fails at a tick if told to."""

    pure = False

    def __init__(self, name, rate, folder, fault="", at=3):
        super().__init__(name, rate)
        self.folder, self.fault, self.at = str(folder), fault, at

    def init(self, parameters, generator, batch):
        assert self.marks("open")[-1] == where(), "init runs where open ran, after it"
        self.steps = 0
        self.output = torch.zeros(batch, 2, dtype=torch.float64)
        return {}

    def initial_output(self, parameters, state, batch):
        return self.output

    def step(self, parameters, state, inputs):
        if self.fault and self.steps == self.at:
            FAULTS[self.fault]()
        self.steps += 1
        if self.fault == "nan" and self.steps > self.at:
            return state, torch.tensor([[1.0, torch.nan]], dtype=torch.float64)
        self.output += self.steps  # the same memory each time
        return state, self.output

    def open(self):
        self._mark("open")

    def close(self):
        if self.fault == "slow close":
            time.sleep(0.3)
        self._mark("close")
        if self.fault == "bad close":
            raise OSError("the drive does not answer")

    def marks(self, what):
        """Return where it was opened or closed, in turn."""
        file = Path(self.folder) / f"{self.name}.{what}"
        return file.read_text().splitlines() if file.exists() else []

    def _mark(self, what):
        with (Path(self.folder) / f"{self.name}.{what}").open("a") as file:
            file.write(f"{where()}\n")


class BigDevice(Device):
    """Puts out 16 MB at each step, so that its process is sending nearly all the time."""

    def init(self, parameters, generator, batch):
        super().init(parameters, generator, batch)
        self.output = torch.zeros(batch, 2_000_000, dtype=torch.float64)
        return {}


class QuietDevice(Device):
    """Says with NaN that it has nothing to say."""

    finite = False


def where() -> str:
    return f"{os.getpid()} {threading.get_ident()}"


def raise_error():
    raise ValueError("encoder cable is off")


def hang():
    while True:
        time.sleep(0.005)


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)
    hang()


def compute():
    return sum(range(150_000_000))  # one call into C: no other thread of the process runs meanwhile


FAULTS = {
    "compute": compute,
    "ctrl-c": interrupt,
    "raise": raise_error,
    "hang": hang,
    "nap": lambda: time.sleep(0.3),
    "sleep": lambda: time.sleep(3600),
    "die": die,
    "bad close": lambda: None,
    "nan": lambda: None,
    "slow close": lambda: None,
}


def act(inputs):
    return policy({name: seen.data for name, seen in inputs.items()}, 1)


def loop(rate=100, agent_rate=50, **options) -> Graph:
    """World, sensor, agent, actuator; every node adds up."""
    action = torch.zeros(2, dtype=torch.float64)
    return Graph(
        [
            Timed("world", rate),
            Timed("sensor", rate),
            Supervisor("agent", agent_rate, initial_action=action),
            Timed("actuator", rate),
        ],
        [
            Connection("world", "sensor", 0.001, **options),
            Connection("sensor", "agent", 0.002, window=2),
            Connection("agent", "actuator", 0.003, window=3, jitter="buffer"),
            Connection("actuator", "world", skip=True),
        ],
    )


def devices(folder, fault="", at=3) -> Graph:
    """A motor that may fail and a healthy camera, both looked at by the agent."""
    action = torch.zeros(2, dtype=torch.float64)
    return Graph(
        [
            Device("motor", 50, folder, fault, at),
            Device("camera", 100, folder),
            Supervisor("agent", 50, initial_action=action),
        ],
        [
            Connection("motor", "agent"),
            Connection("camera", "agent", window=2),
            Connection("agent", "motor", skip=True),
        ],
    )


def run(runtime, steps: int, seed: int = 0) -> Episode:
    with runtime:
        runtime.reset({}, torch.Generator().manual_seed(seed))
        runtime.run(act, steps)
        return runtime.finish()


def assert_same(first: Episode, second: Episode) -> None:
    for part in PARTS:
        old, new = getattr(first, part), getattr(second, part)
        assert old.keys() == new.keys()
        for key, array in old.items():
            np.testing.assert_array_equal(array, new[key], err_msg=f"{part} {key}")
            assert array.dtype == new[key].dtype
