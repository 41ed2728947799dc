"""Hidden units before a camera: what is drawn, and their recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepkoco.excitation.excitation import make_excitation
from deepkoco.graph import Episode, Graph, Input, draw_timing
from deepkoco.graph.live import SimulatedRuntime
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.vision import Scene, camera_chain, draw_backdrop, median_picture, seen_log
from deepkoco.vision.chain import CONTROL_RATE
from deepkoco.vision.picture import MASS_COLOUR

SPREAD = 0.1  # of the parameters of the pendulum, relative
BIAS = 0.03  # of the amplifier [V]
DELAYS = {"actuation_delay.delay": (0.004, 0.012), "camera_delay": (0.005, 0.015)}  # [s]
CAMERA = {
    "pivot_u": (-4.0, 4.0),
    "pivot_v": (-4.0, 4.0),
    "scale": (44.0, 52.0),
    "roll": (-0.08, 0.08),
    "tilt_u": (-0.15, 0.15),
    "tilt_v": (-0.15, 0.15),
    "perspective": (0.10, 0.20),
    "lens": (-0.03, 0.03),
}
TACHOMETER = {"tacho_gain": (0.95, 1.05), "tacho_zero": (-0.1, 0.1)}
EXPOSURE, JITTER = 0.006, 0.001  # [s]
TRANSPORT = {"law": "gamma", "shape": 4.0, "scale": 5e-4, "offset": 0.002}
HANGING = np.pi
LEARNING = 6.0  # of the film from which the background is learned [s]
AMPLITUDE = 2.5  # of the steps [V]
PENDULUM = ("inertia", "mass", "length", "viscous", "motor_constant", "resistance", "coulomb")
BIASED = ExtendedSystem(make_system("pendulum"), ("torque_bias",))


@dataclass(frozen=True)
class HiddenUnit:
    """A pendulum and its camera.

    Attributes:
        values: True value of each parameter that a fit may seek.
        seed: Of its draws, its wall and its noise.
    """

    values: dict[str, float]
    seed: int

    @classmethod
    def draw(cls, seed: int) -> HiddenUnit:
        """Parameters up to 10 % from nominal; delays, camera and tachometer uniform between limits."""
        random = np.random.default_rng([seed, 25])
        nominal = make_system("pendulum")
        values = {
            n: nominal.parameter(n).value * random.uniform(1.0 - SPREAD, 1.0 + SPREAD) for n in PENDULUM
        }
        for limits in (CAMERA, DELAYS, TACHOMETER):
            values |= {name: float(random.uniform(*ends)) for name, ends in limits.items()}
        return cls({**values, "torque_bias.effort": float(random.uniform(-BIAS, BIAS))}, seed)

    @property
    def scene(self) -> Scene:
        """What its camera looks at."""
        return Scene(draw_backdrop(self.seed, MASS_COLOUR))

    @property
    def parameters(self) -> dict[str, dict[str, Tensor]]:
        """Of the nodes of its graph."""
        as_tensor = {n: torch.tensor(v, dtype=torch.float64) for n, v in self.values.items()}
        world = {n: as_tensor[n] for n in (*PENDULUM, "torque_bias.effort")}
        times = {"latency": self.values["camera_delay"], "jitter": JITTER, "exposure": EXPOSURE}
        camera = {n: as_tensor[n] for n in CAMERA} | {
            n: torch.tensor(v, dtype=torch.float64) for n, v in times.items()
        }
        return {"world": world, "camera": camera, "tachometer": {n: as_tensor[n] for n in TACHOMETER}}

    def graph(self, background: np.ndarray | None = None) -> Graph:
        """Its camera chain; None takes the wall for the background before it is learned."""
        longest = {"latency": DELAYS["camera_delay"][1], "jitter": JITTER, "exposure": EXPOSURE}
        return camera_chain(
            self.scene,
            background,
            system=BIASED,
            actuation_delay=self.values["actuation_delay.delay"],
            transport=TRANSPORT,
            times=longest,
        )


@dataclass(frozen=True)
class Taken:
    """A recording of a unit.

    Attributes:
        graph, episode: What ran.
        log: What a fit takes of it.
    """

    graph: Graph
    episode: Episode
    log: Recording

    @property
    def truth(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and true angles [rad] of the world."""
        states = self.episode.outputs["world"]
        return self.episode.t_start["world"][: len(states)], states[:, 0]


def record(unit: HiddenUnit, background: np.ndarray | None, seconds: float, seed: int) -> Taken:
    """Drive a unit with random steps.

    Args:
        unit: The unit.
        background: What its reader takes for still.
        seconds: Length [s].
        seed: Of the excitation, the delays and the noise.
    """
    graph = unit.graph(background)
    count = round(seconds * CONTROL_RATE)
    timing = draw_timing(graph, np.random.default_rng([unit.seed, seed]), count, 1)
    drive = make_excitation("steps", "pendulum", seconds, 1000 * unit.seed + seed, AMPLITUDE)

    def policy(inputs: dict[str, Input]) -> Tensor:
        seen = inputs["tachometer"]
        volts = drive(float(seen.t_start[0]), (0.0, float(seen.data[0, -1, 0])))
        return torch.tensor([[volts]], dtype=torch.float64)

    start = {"world": {"state": torch.tensor([[HANGING - 0.2, 0.0]], dtype=torch.float64)}}
    generator = torch.Generator().manual_seed(100 * unit.seed + seed)
    with SimulatedRuntime(graph, timing) as runtime:
        runtime.reset(unit.parameters, generator, start)
        runtime.run(policy, count)
        episode = runtime.finish()
    return Taken(graph, episode, seen_log(graph, episode))


def learned_background(unit: HiddenUnit) -> np.ndarray:
    """The median of a film in which the mass swings: no picture of the bare wall is given."""
    film = record(unit, None, LEARNING, 0)
    return median_picture(film.episode.outputs["camera"][::3])
