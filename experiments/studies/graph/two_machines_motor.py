"""The graph of the kills: a motor at the robot, whose commands a witness outside of both ends writes down."""

from __future__ import annotations

import os
import socket
import struct

import torch
from torch import Tensor

from deepkoco.graph import Connection, Graph, Input, Node, Supervisor
from deepkoco.graph.model.node import Parameters, State

RATE = 100.0  # Hz
PORT = "TWO_MACHINES_WITNESS"
"""Environment variable with the port of the witness."""
FRAME = struct.Struct("<qd")  # process of the motor, command


class Motor(Node):
    """Hands each command on to the witness, as to a drive; closed, it hands on zero."""

    inputs = ("agent",)
    pure = False

    def open(self) -> None:
        self.witness = socket.create_connection(("127.0.0.1", int(os.environ[PORT])))
        self.witness.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.zeros(batch, 1, dtype=torch.float64)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        command = inputs["agent"].data[:, -1]
        self._hand_on(float(command))
        return state, command

    def close(self) -> None:
        self._hand_on(0.0)
        self.witness.close()

    def _hand_on(self, command: float) -> None:
        self.witness.sendall(FRAME.pack(os.getpid(), command))


def graph() -> Graph:
    """Motor and agent."""
    action = torch.zeros(1, dtype=torch.float64)
    return Graph(
        [Motor("motor", RATE), Supervisor("agent", RATE, initial_action=action)],
        [Connection("motor", "agent", 0.001), Connection("agent", "motor", 0.001, skip=True)],
    )


def policy(inputs: dict[str, Input]) -> Tensor:
    """Full power."""
    return torch.ones(1, 1, dtype=torch.float64)
