"""What the studies of the concurrent and the wall-clock runtime share: nodes, load of the machine, results."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from deepkoco.graph import Connection, Graph, Input, Node, Supervisor
from deepkoco.graph.model.node import Parameters, State
from deepkoco.output.new_folder import new_folder
from deepkoco.systems import make_system, rk4_step
from experiments.provenance import as_markdown

if TYPE_CHECKING:
    from deepkoco.graph.drawing.style import Picture


class PendulumWorld(Node):
    """The rod pendulum, one Runge-Kutta step a tick, under the last command; the output (B, 2) is its state.

    Tick 0 puts out the start state.
    """

    inputs = ("agent",)

    def __init__(self, name: str, rate: float) -> None:
        super().__init__(name, rate)
        self.system = make_system("rod_pendulum")
        self.constants = self.system.default_parameters()

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        start = torch.tensor([[3.0, 0.0]], dtype=torch.float64).repeat(batch, 1)
        return {"state": start, "started": torch.zeros(batch, dtype=torch.bool)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["state"]

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        torque = inputs["agent"].data[:, -1, 0]
        after = rk4_step(self.system, state["state"], torque, float(1 / self.rate), self.constants)
        now = torch.where(state["started"][:, None], after, state["state"])
        return {"state": now, "started": torch.ones_like(state["started"])}, now


class Relay(Node):
    """Passes the last message on, after a computation of a given length.

    Args:
        name: unique in the graph.
        rate: ticks per second [Hz].
        work: time that a step takes for real [s].
        spin: whether it keeps the core busy meanwhile; else it sleeps, as one that waits for a device.
        size: entries of its output.
    """

    def __init__(self, name: str, rate: float, work: float = 0.0, spin: bool = False, size: int = 2) -> None:
        super().__init__(name, rate)
        self.work, self.spin, self.size = work, spin, size

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.zeros(batch, self.size, dtype=torch.float64)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        end = time.monotonic() + self.work
        if self.spin:
            while time.monotonic() < end:
                pass
        elif self.work:
            time.sleep(self.work)
        newest = next(iter(inputs.values())).data[:, -1]
        return state, newest.expand(len(newest), self.size)


def pendulum_loop(world_rate: float, sensor_rate: float, agent_rate: float, delay: float) -> Graph:
    """Pendulum, sensor and agent; measurements and commands each travel `delay` [s]."""
    action = torch.zeros(1, dtype=torch.float64)
    return Graph(
        [
            PendulumWorld("world", world_rate),
            Relay("sensor", sensor_rate),
            Supervisor("agent", agent_rate, initial_action=action, phase=0),
        ],
        [
            Connection("world", "sensor"),
            Connection("sensor", "agent", delay, skip=delay > 0),
            Connection("agent", "world", delay, skip=True),
        ],
    )


def load() -> float:
    """Load average of the last minute; nan where the system does not tell."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")


def run_study(
    argv: Sequence[str] | None,
    parser: argparse.ArgumentParser,
    study: Callable[[argparse.Namespace], tuple[list[Picture], str]],
) -> int:
    """Run a study and leave its pictures, tables and README in the folder of `--out`, whole or not at all.

    Args:
        argv: arguments of the command.
        parser: its own arguments; `--out` must be among them.
        study: from the arguments to the pictures and the text of the README.

    Returns:
        The exit status: 2 where the folder exists.
    """
    arguments = parser.parse_args(argv)
    out: Path = arguments.out
    if out.exists():
        print(f"error: {out}: exists; move it away or pass another --out", file=sys.stderr)
        return 2
    before = load()
    pictures, text = study(arguments)
    with new_folder(out) as partial:
        for picture in pictures:
            picture.save(partial)
        machine = f"| load average before, after | {before:.2f}, {load():.2f} |"
        (partial / "README.md").write_text(f"{text}\n\n{as_markdown()}\n{machine}\n")
    return 0
