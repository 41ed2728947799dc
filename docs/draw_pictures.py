"""Draws the pictures of the documentation: python docs/draw_pictures.py"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph import Connection, Episode, Gaussian, Graph, Input, Mixture, Node, Supervisor, draw_timing
from deepkoco.graph.drawing import draw_graph, draw_timeline
from deepkoco.graph.episodes.episode import episode_of_timing
from deepkoco.graph.model.node import Parameters, State

IMAGES = Path(__file__).parent / "images"


class Still(Node):
    """Sends zeros: the pictures show times."""

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.zeros(batch, 1)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        return state, torch.zeros(1, 1)


def robot() -> Graph:
    """A camera and an encoder, an estimator that waits for the encoder, an agent and a motor."""
    network = Mixture((Gaussian(0.006, 0.0015), Gaussian(0.04, 0.005)), (0.95, 0.05))
    return Graph(
        [
            Still("world", 200),
            Still("encoder", 100, 0.0005),
            Still("camera", 30, Gaussian(0.018, 0.004)),
            Still("estimator", 50, Gaussian(0.004, 0.001)),
            Supervisor(rate=20, initial_action=torch.zeros(1)),
            Still("motor", 100, 0.001),
        ],
        [
            Connection("world", "encoder"),
            Connection("world", "camera"),
            Connection("encoder", "estimator", 0.002, window=3, blocking=True),
            Connection("camera", "estimator", network),
            Connection("estimator", "agent", 0.001),
            Connection("agent", "motor", network),
            Connection("motor", "world", skip=True),
        ],
    )


def lose(episode: Episode, key: str, seq: int) -> Episode:
    """Let one message never arrive."""
    received = episode.t_received[key].copy()
    received[seq] = np.inf
    windows = episode.windows[key].copy()
    windows[windows == seq] = seq - 1
    return replace(
        episode,
        t_received=episode.t_received | {key: received},
        windows=episode.windows | {key: windows},
    )


def main() -> None:
    graph = robot()
    timing = draw_timing(graph, np.random.default_rng(3), steps=20, batch=1)
    episode = lose(episode_of_timing(graph, timing), "camera->estimator", 6)
    for picture in (draw_graph(graph), draw_timeline(graph, episode, stop=0.3)):
        for old in IMAGES.glob(f"{picture.name}.*"):
            old.unlink()
        picture.save(IMAGES)[1].unlink()  # the table is for studies


if __name__ == "__main__":
    main()
